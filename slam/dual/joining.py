"""Saved maps met again: place recognition between the current map and those whose recovery has failed."""

import numpy as np

from slam.dual.fusion import FusionConfig, agree
from slam.map import Map
from slam.map_alignment import Alignment, align
from slam.place_recognition import KeyframeDatabase

_CANDIDATES = 2  # likeliest keyframes of a saved map that are compared with a new keyframe


class MapJoiner:
    """Compares keyframes of the current map with the saved maps, as loop closing does within one map.

    Args:
        config: acceptance; the gap between frames does not matter here.
    """

    def __init__(self, config: FusionConfig) -> None:
        self._config = config
        self._found: dict[tuple[int, int], list[Alignment]] = {}

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

    def forget(self) -> None:
        """What was found is void: maps have changed."""
        self._found.clear()
