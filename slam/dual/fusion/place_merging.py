"""Saved maps met again: place recognition between the current map and those whose recovery has failed."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

import numpy as np

from slam.core.seeds import rng_for
from slam.dual.fusion.fuse import FusionConfig, agree
from slam.loop_closing.map_alignment import Alignment, align
from slam.map.map import Map
from slam.optimization.sim3 import sim3_inverse
from slam.places.recognition import KeyframeDatabase

_CANDIDATES = 2  # likeliest keyframes of a saved map that are compared with a new keyframe
_WAITING = 3  # newest keyframes that are looked for in saved maps, when that has had to wait


class PlaceMerger:
    """Compares keyframes of the current map with the saved maps, as loop closing does within one map.

    Args:
        config: acceptance; the gap between frames does not matter here.
        seed: the system's.
    """

    def __init__(self, config: FusionConfig, seed: int) -> None:
        self._config = config
        self._seed = seed
        self._waiting: list[int] = []
        self._found: dict[tuple[int, int], list[Alignment]] = {}

    def note(self, keyframe: int) -> None:
        """The current map has a new keyframe, to be looked for when there is time."""
        self._waiting = [*self._waiting[1 - _WAITING :], keyframe]

    def search(
        self,
        current: Map,
        saved: Sequence[Map],
        database_of: Callable[[int], KeyframeDatabase],
        lock: AbstractContextManager,
    ) -> tuple[Alignment, ...]:
        """Look for the noted keyframes in the saved maps.

        Args:
            current: the map of the keyframes.
            saved: maps, none of which grows.
            database_of: place recognition in a map, by its number.
            lock: held while the current map is read.

        Returns:
            Alignments with one saved map that agree, as :meth:`offer` gives them.
        """
        keyframes, self._waiting = self._waiting, []
        for keyframe in keyframes:
            for old in saved:
                rng = rng_for(self._seed, "joining", current.frame_index(keyframe), old.map_id)
                with lock:
                    if current.arrays.kf_bad[keyframe]:
                        continue
                    alignments = self.offer(current, keyframe, old, database_of(old.map_id), rng)
                if alignments:
                    return alignments
        return ()

    def offer(
        self, current: Map, keyframe: int, old: Map, database: KeyframeDatabase, rng: np.random.Generator
    ) -> tuple[Alignment, ...]:
        """Look for a new keyframe's place in a saved map.

        Args:
            current: the map of the keyframe.
            keyframe: its row.
            old: a saved map.
            database: its keyframes.
            rng: stream of the RANSAC.

        Returns:
            Alignments at different keyframes that agree, the last found last; none while there are too few.
        """
        known = self._found.setdefault((old.map_id, current.map_id), [])
        bow = database.vocabulary.transform(current.features(keyframe).descriptors)
        for candidate in database.relocalization_candidates(bow)[:_CANDIDATES]:
            alignment, _, _ = align(old, current, candidate, keyframe, rng, self._config)
            if alignment is None:
                continue
            agreeing = tuple(a for a in known if agree(old, a, alignment, self._config))
            known.append(alignment)
            if len(agreeing) + 1 >= self._config.confirmations:
                return (*agreeing, alignment)
        return ()

    def moved_on(self) -> None:
        """The current map is another one."""
        self._waiting.clear()

    def forget(self) -> None:
        """What was found is void: maps have changed."""
        self._found.clear()


def turned(alignment: Alignment, new_map_id: int) -> Alignment:
    """The same alignment with the two maps' parts exchanged; ``new_map_id``: the map that was the new one."""
    return Alignment(
        sim3_inverse(alignment.S_old_new),
        1.0 / alignment.scale,
        new_map_id,
        alignment.new_keyframe,
        alignment.old_keyframe,
        alignment.new_points,
        alignment.old_points,
    )
