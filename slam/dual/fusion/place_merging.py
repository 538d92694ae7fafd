"""Place recognition between the current map and saved maps whose recovery has failed."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np

from dslab.slam.belief.belief import DISBELIEVED
from dslab.slam.belief.config import BeliefConfig
from dslab.slam.core.frame import Frame
from dslab.slam.core.seeds import rng_for
from dslab.slam.dual.fusion.fuse import FusedMaps, FusionConfig
from dslab.slam.dual.fusion.map_merger import STAGE, MapMerger
from dslab.slam.loop_closing.map_alignment import Alignment, align, align_relocalized
from dslab.slam.loop_closing.supposed import Supposed, suppose
from dslab.slam.map.map import Map
from dslab.slam.map_store import Places
from dslab.slam.optimization.sim3 import sim3_inverse
from dslab.slam.places.recognition import shipped_vocabulary
from dslab.slam.runtime.backend import MapChange

_CANDIDATES = 2  # most similar keyframes of a saved map that are compared with a new keyframe
_WAITING = 3  # newest keyframes that are searched when the search was delayed


class PlaceMerger:
    """Recognises saved maps from keyframes of the current one, as in loop closing.

    An alignment supposes where a saved map lies. The views of the keyframes around and of later ones speak
    for or against it, and so do others that cannot hold too.

    Args:
        config: acceptance thresholds; ``max_time_gap_s`` is not used.
        beliefs: when a place counts.
        seed: the system's.

    Attributes:
        searching: a search is under way or waits.
        refused: alignments that were refused in the last search, with the reasons.
    """

    def __init__(self, config: FusionConfig, beliefs: BeliefConfig, seed: int) -> None:
        self._config = config
        self._beliefs = beliefs
        self._seed = seed
        self._searched = (-1, 0)  # a map, and its keyframes that need not be searched any more
        self._supposed: list[Supposed] = []
        self._corrections = 0
        self.searching = False
        self._refused_last: Alignment | None = None
        self.refused: list[tuple[Alignment, str]] = []

    def skip(self, current: Map) -> None:
        """Search no keyframe that the current map has now."""
        self._forget_other_than(current)
        self._searched = (current.map_id, current.n_keyframes)

    def is_due(self, current: Map) -> bool:
        """Return True if the current map has keyframes that have not been searched, and no search waits."""
        return not self.searching and self._next_of(current) < current.n_keyframes

    def search(
        self,
        current: Map,
        saved: Sequence[Map],
        places_of: Callable[[int], Places],
        lock: AbstractContextManager,
    ) -> tuple[Alignment, ...]:
        """Search the saved maps for the current map's newest keyframes.

        Args:
            current: the map of the keyframes, which gains and loses none meanwhile.
            saved: saved maps; none of them grows.
            places_of: place recognition in a map, by its id.
            lock: held while a database is used: tracking looks for lost frames in it.

        Returns:
            Alignments with one saved map at different keyframes that agree, the newest last; empty while
            there are too few.
        """
        self.refused = []
        self._forget_other_than(current)
        self._supposed = [s for s in self._supposed if any(s.old is m for m in saved)]
        for keyframe in range(self._next_of(current), current.n_keyframes):
            self._searched = (current.map_id, keyframe + 1)
            if current.arrays.kf_bad[keyframe]:
                continue
            bow = shipped_vocabulary().transform(current.features(keyframe).descriptors)
            for old in saved:
                rng = rng_for(self._seed, "joining", current.frame_index(keyframe), old.map_id)
                places = places_of(old.map_id)
                with lock:
                    similar = places.database.relocalization_candidates(bow)
                for alignment in self._alignments(current, keyframe, old, places, similar, rng):
                    suppose(self._supposed, old, current, alignment, self._config, self._beliefs)
            for supposed in self._supposed:
                supposed.look(current, keyframe)
            accepted = self._decided(current)
            if accepted:
                return accepted
        return ()

    def _forget_other_than(self, current: Map) -> None:
        """Discard the hypotheses if they are of another current map."""
        if self._searched[0] != current.map_id:
            self._supposed.clear()

    def _next_of(self, current: Map) -> int:
        """The first keyframe of the current map that is to be searched."""
        map_id, searched = self._searched
        return max(searched if map_id == current.map_id else 0, current.n_keyframes - _WAITING)

    def _alignments(
        self,
        current: Map,
        keyframe: int,
        old: Map,
        places: Places,
        similar: Sequence[int],
        rng: np.random.Generator,
    ) -> list[Alignment]:
        """Align a new keyframe with similar ones of a saved map, or else with all that it finds of it."""
        pairs = (align(old, current, k, keyframe, rng, self._config)[0] for k in similar[:_CANDIDATES])
        found = [alignment for alignment in pairs if alignment is not None]
        if found or not similar:
            return found
        frame = Frame(current.features(keyframe))
        if not places.relocalizer.relocalize(frame, rng, similar=similar).success:
            return []
        alignment = align_relocalized(old, current, frame, keyframe, rng, self._config)
        return [alignment] if alignment is not None else []

    def _decided(self, current: Map) -> tuple[Alignment, ...]:
        """The alignments of what is believed, the newest last, if they are at keyframes enough."""
        for supposed in self._supposed:
            standing = [a for a in supposed.alignments if not current.arrays.kf_bad[a.new_keyframe]]
            if len({a.old_keyframe for a in standing}) < self._config.confirmations:
                continue
            if supposed.is_believed(self._supposed):
                return tuple(replace(a, believed=supposed.believed) for a in standing)
            if supposed.believed < 0.5 and supposed.newest is not self._refused_last:
                self._refused_last = supposed.newest
                told = replace(supposed.newest, believed=supposed.believed)
                self.refused.append((told, DISBELIEVED))
        return ()

    def reset_alignments(self) -> None:
        """Discard the alignments found so far: a map has changed."""
        self._supposed.clear()

    def note_corrections(self, corrections: int) -> None:
        """Discard the alignments if maps were corrected since; ``corrections``: how often they ever were."""
        if corrections != self._corrections:
            self._corrections = corrections
            self.reset_alignments()


class PlaceFusion(MapChange):
    """Fusion of the current map with a saved one whose place is recognised.

    Args:
        merger: of the maps.
        places: recognises them, from the current map's newest keyframes.
    """

    stage = STAGE

    def __init__(self, merger: MapMerger, places: PlaceMerger) -> None:
        self._merger = merger
        self._places = places
        self._current_id = -1
        self._refused: tuple[tuple[Alignment, str], ...] = ()
        self._fusion: FusedMaps | None = None
        places.searching = True

    def prepare(self) -> bool:
        """Search the places; fuse copies of the two maps, of which the older one keeps its frame."""
        engine, places = self._merger.engine, self._places
        store, current = engine.store, engine.store.current
        places.searching = False
        self._current_id = current.map_id
        places.note_corrections(engine.handover.corrections)
        saved = [store[k] for k in store.saved]
        alignments = places.search(current, saved, store.places, engine.backend.lock)
        self._refused = tuple(places.refused)
        if alignments:
            old, new = store[alignments[-1].old_map_id], current
            if old.map_id > new.map_id:
                old, new, alignments = new, old, tuple(inverted(a, current.map_id) for a in alignments)
            self._fusion = FusedMaps.of(old, new.copy(), alignments, engine.config.mapping)
        return bool(alignments or self._refused)

    def is_still_valid(self) -> bool:
        """Return True if both maps are still there."""
        return self._fusion is None or self._merger.has_both(self._fusion)

    def commit(self) -> None:
        """Report the places that were refused; fuse the maps if one was not."""
        for alignment, reason in self._refused:
            self._merger.refuse(alignment.old_map_id, self._current_id, "place", alignment, reason)
        if self._fusion is not None:
            self._merger.commit(self._fusion, "place")


def inverted(alignment: Alignment, new_map_id: int) -> Alignment:
    """Exchange the two maps of an alignment.

    Args:
        alignment: between an old and a new map.
        new_map_id: id of the new map, the old one in the result.
    """
    return Alignment(
        sim3_inverse(alignment.S_old_new),
        1.0 / alignment.scale,
        new_map_id,
        alignment.new_keyframe,
        alignment.old_keyframe,
        alignment.new_points,
        alignment.old_points,
        alignment.believed,
    )
