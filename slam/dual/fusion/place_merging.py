"""Place recognition between the current map and saved maps whose recovery has failed."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

import numpy as np

from slam.core.seeds import rng_for
from slam.dual.fusion.fuse import FusionConfig, confirms
from slam.loop_closing.map_alignment import Alignment, agree, align
from slam.loop_closing.place_check import doubt
from slam.map.map import Map
from slam.optimization.sim3 import sim3_inverse
from slam.places.recognition import KeyframeDatabase, shipped_vocabulary

_CANDIDATES = 2  # most similar keyframes of a saved map that are compared with a new keyframe
_WAITING = 3  # newest keyframes that are searched when the search was delayed


class PlaceMerger:
    """Recognises saved maps from keyframes of the current one, as in loop closing.

    Args:
        config: acceptance thresholds; ``max_time_gap_s`` is not used.
        seed: the system's.

    Attributes:
        refused: alignments that were confirmed and yet refused in the last search, with the reasons.
    """

    def __init__(self, config: FusionConfig, seed: int) -> None:
        self._config = config
        self._seed = seed
        self._searched = (-1, 0)  # a map, and its keyframes that need not be searched any more
        self._found: dict[tuple[int, int], list[Alignment]] = {}
        self._judged: dict[tuple[int, int], list[tuple[Alignment, str]]] = {}
        self.refused: list[tuple[Alignment, str]] = []

    def skip(self, current: Map) -> None:
        """Search no keyframe that the current map has now."""
        self._searched = (current.map_id, current.n_keyframes)

    def is_due(self, current: Map) -> bool:
        """Return True if the current map has keyframes that have not been searched."""
        return self._next_of(current) < current.n_keyframes

    def search(
        self,
        current: Map,
        saved: Sequence[Map],
        database_of: Callable[[int], KeyframeDatabase],
        lock: AbstractContextManager,
    ) -> tuple[Alignment, ...]:
        """Search the saved maps for the current map's newest keyframes.

        Args:
            current: the map of the keyframes, which gains and loses none meanwhile.
            saved: saved maps; none of them grows.
            database_of: keyframe database of a map, by its id.
            lock: held while a database is used: tracking looks for lost frames in it.

        Returns:
            Alignments with one saved map at different keyframes that agree, the newest last; empty while
            there are too few.
        """
        self.refused = []
        for keyframe in range(self._next_of(current), current.n_keyframes):
            self._searched = (current.map_id, keyframe + 1)
            if current.arrays.kf_bad[keyframe]:
                continue
            bow = shipped_vocabulary().transform(current.features(keyframe).descriptors)
            for old in saved:
                rng = rng_for(self._seed, "joining", current.frame_index(keyframe), old.map_id)
                with lock:
                    candidates = database_of(old.map_id).relocalization_candidates(bow)
                alignments = self._compare(current, keyframe, old, candidates[:_CANDIDATES], rng)
                if alignments:
                    return alignments
        return ()

    def _next_of(self, current: Map) -> int:
        """The first keyframe of the current map that is to be searched."""
        map_id, searched = self._searched
        return max(searched if map_id == current.map_id else 0, current.n_keyframes - _WAITING)

    def _compare(
        self, current: Map, keyframe: int, old: Map, candidates: Sequence[int], rng: np.random.Generator
    ) -> tuple[Alignment, ...]:
        """Compare a new keyframe with keyframes of a saved map.

        Returns:
            Alignments at different keyframes that agree, the newest last; empty while there are too few.
        """
        known = self._found.setdefault((old.map_id, current.map_id), [])
        for candidate in candidates:
            alignment, _, _ = align(old, current, candidate, keyframe, rng, self._config)
            if alignment is None:
                continue
            agreeing = tuple(a for a in known if confirms(old, a, alignment, self._config))
            known.append(alignment)
            if len(agreeing) + 1 < self._config.confirmations:
                continue
            others = sum(not agree(old, a, alignment, self._config) for a in known)
            if 2 * others > len(agreeing) + 1:
                reason = "ambiguous"
            else:
                reason = self._judge(old, current, alignment, rng)
            if not reason:
                return (*agreeing, alignment)
            self.refused.append((alignment, reason))
        return ()

    def _judge(self, old: Map, current: Map, alignment: Alignment, rng: np.random.Generator) -> str:
        """What speaks against an alignment, also what has spoken against the same one before."""
        judged = self._judged.setdefault((old.map_id, current.map_id), [])
        reason = doubt(old, current, alignment, rng, self._config.place)
        judged.append((alignment, reason))
        same = [r for a, r in judged if agree(old, a, alignment, self._config)]
        if not reason and same.count("") < self._config.place.min_sound * len(same):
            return next(r for r in reversed(same) if r)
        return reason

    def reset_alignments(self) -> None:
        """Discard the alignments found so far: a map has changed."""
        self._found.clear()
        self._judged.clear()


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
