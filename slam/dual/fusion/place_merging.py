"""Place recognition between the current map and saved maps whose recovery has failed."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

import numpy as np

from dslab.slam.core.frame import Frame
from dslab.slam.core.seeds import rng_for
from dslab.slam.dual.fusion.fuse import FusedMaps, FusionConfig
from dslab.slam.dual.fusion.hypotheses import Hypothesis, rival
from dslab.slam.dual.fusion.map_merger import STAGE, MapMerger
from dslab.slam.loop_closing.map_alignment import Alignment, agree, align, align_relocalized
from dslab.slam.loop_closing.place_check import (
    PlaceCheckConfig,
    double_in_reach,
    fault_of_alignment,
    within_reach,
)
from dslab.slam.map._map_kernels import resolve_points
from dslab.slam.map.map import Map
from dslab.slam.map_store import Places
from dslab.slam.optimization.sim3 import sim3_inverse
from dslab.slam.places.recognition import shipped_vocabulary
from dslab.slam.runtime.backend import MapChange
from dslab.slam.tracking.probation import Probation

_CANDIDATES = 2  # most similar keyframes of a saved map that are compared with a new keyframe
_WAITING = 3  # newest keyframes that are searched when the search was delayed


class PlaceMerger:
    """Recognises saved maps from keyframes of the current one, as in loop closing, and more sceptically.

    An alignment is a hypothesis of where a saved map lies. The views of later keyframes speak for or against
    it; if the maps are far apart in time it takes some seconds of them, and no other hypothesis that does as
    well and cannot hold too.

    Args:
        config: acceptance thresholds; ``max_time_gap_s`` is not used.
        place: what keyframes must show, unless ``config`` says so.
        seed: the system's.

    Attributes:
        searching: a search is under way or waits.
        refused: alignments that were refused in the last search, with the reasons.
    """

    def __init__(self, config: FusionConfig, place: PlaceCheckConfig, seed: int) -> None:
        self._config = config
        self._place = config.place or place
        self._seed = seed
        self._searched = (-1, 0)  # a map, and its keyframes that need not be searched any more
        self._hypotheses: list[Hypothesis] = []
        self._corrections = 0
        self.searching = False
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
        self._hypotheses = [h for h in self._hypotheses if any(h.old is m for m in saved)]
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
                    self._note(current, keyframe, old, alignment, rng)
            for hypothesis in self._hypotheses:
                hypothesis.look(current, keyframe, self._place)
            accepted = self._decided(current)
            if accepted:
                return accepted
        return ()

    def of_frames(self, current: Map, old: Map, frames: Sequence[Frame]) -> tuple[Alignment, ...]:
        """Align the current map with a saved one by frames that are tracked in both.

        Args:
            current: a map of which some of the frames are keyframes.
            old: the saved map; it need not be seen by the keyframes' own search.
            frames: tracked in the saved map, and confirmed there.

        Returns:
            Alignments that agree with the last one, the newest last; empty if they are too few or the fewer,
            or the camera cannot have come there, or can as well have come to a known double of the place.
        """
        config, place = self._config, self._place
        keyframes = {current.frame_index(int(k)): int(k) for k in current.keyframes()}
        found: list[Alignment] = []
        for frame in frames:
            keyframe = keyframes.get(frame.features.index)
            # A map's first keyframes have far more features than the frames that are sought.
            if keyframe is None or len(frame.features) != len(current.features(keyframe)):
                continue
            rng = rng_for(self._seed, "joining", frame.features.index, old.map_id)
            resolve_points(old.arrays, frame.point)
            alignment = align_relocalized(old, current, frame, keyframe, rng, config)
            if alignment is not None:
                found.append(alignment)
        if not found or not within_reach(old, current, found[-1].S_old_new, place.reach):
            return ()
        agreeing = tuple(a for a in found if agree(old, found[-1], a, config))
        if len(agreeing) < config.confirmations or 2 * len(agreeing) <= len(found):
            return ()
        return () if double_in_reach(old, current, found[-1].S_old_new, place) else agreeing

    def _forget_other_than(self, current: Map) -> None:
        """Discard the hypotheses if they are of another current map."""
        if self._searched[0] != current.map_id:
            self._hypotheses.clear()

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

    def _note(
        self, current: Map, keyframe: int, old: Map, alignment: Alignment, rng: np.random.Generator
    ) -> None:
        """Note an alignment of a new keyframe with a saved map, and what speaks against it."""
        config = self._config
        reason = fault_of_alignment(old, current, alignment, rng, self._place)
        if reason:
            self.refused.append((alignment, reason))
        known = next((h for h in self._hypotheses if h.is_that_of(alignment, config)), None)
        if known is None:
            if reason == "out_of_reach":
                return
            known = Hypothesis(old, [])
            self._hypotheses.append(known)
        known.alignments.append(alignment)
        known.verdicts[keyframe] = known.verdicts.get(keyframe) or reason

    def _decided(self, current: Map) -> tuple[Alignment, ...]:
        """The alignments of a hypothesis that has shown enough and has no rival that is as sound."""
        config, place = self._config, self._place
        for hypothesis in self._hypotheses:
            accepted = hypothesis.accepted(current, place, config.confirmations)
            if not accepted:
                continue
            if not any(
                other is not hypothesis
                and other.is_nearly_as_good_as(hypothesis, place.far_sound)
                and rival(hypothesis, other, place)
                for other in self._hypotheses
            ):
                return accepted
            self.refused.append((hypothesis.newest, "ambiguous"))
        return ()

    def reset_alignments(self) -> None:
        """Discard the alignments found so far: a map has changed."""
        self._hypotheses.clear()

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
        confirmed: a probation in a saved map that frames of the current one have passed: by these frames
            the two are aligned instead.
    """

    stage = STAGE

    def __init__(self, merger: MapMerger, places: PlaceMerger, confirmed: Probation | None = None) -> None:
        self._merger = merger
        self._places = places
        self._confirmed = confirmed
        self._current_id = -1
        self._refused: tuple[tuple[Alignment, str], ...] = ()
        self._fusion: FusedMaps | None = None
        places.searching = True

    def prepare(self) -> bool:
        """Search the places; fuse copies of the two maps, of which the older one keeps its frame."""
        engine, places, confirmed = self._merger.engine, self._places, self._confirmed
        store, current = engine.store, engine.store.current
        places.searching = False
        self._current_id = current.map_id
        if confirmed is None:
            saved = [store[k] for k in store.saved]
            places.note_corrections(engine.handover.corrections)
            alignments = places.search(current, saved, store.places, engine.backend.lock)
            self._refused = tuple(places.refused)
        elif confirmed.map_id in store.saved:
            alignments = places.of_frames(current, store[confirmed.map_id], confirmed.frames)
        else:  # joined meanwhile
            return False
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
    )
