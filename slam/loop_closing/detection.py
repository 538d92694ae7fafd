"""Loop detection: recognise a place and estimate the drift since as a similarity.

Source: Mur-Artal, Montiel, Tardos, "ORB-SLAM", 2015, section VII.
"""

from dataclasses import dataclass, replace

import numpy as np

from dslab.slam.belief.belief import DISBELIEVED
from dslab.slam.belief.config import BeliefConfig
from dslab.slam.core.settings import setting, settings
from dslab.slam.loop_closing._alignment_kernels import match_across
from dslab.slam.loop_closing.correction import Loop
from dslab.slam.loop_closing.map_alignment import Agreement, Alignment, Sim3AlignmentConfig, align
from dslab.slam.loop_closing.supposed import Supposed, suppose
from dslab.slam.loop_closing.torn import torn
from dslab.slam.map.map import Map
from dslab.slam.optimization.sim3 import sim3_decompose, sim3_inverse
from dslab.slam.places.recognition import KeyframeDatabase


@settings
class LoopClosingConfig:
    """Acceptance thresholds of a loop."""

    min_gap: int = setting(10, "least number of keyframes between two loops, and before the first")
    consistency: int = setting(3, "consecutive keyframes whose candidates must be covisible")
    alignment: Sim3AlignmentConfig = setting(
        Sim3AlignmentConfig(min_candidates=20, min_inliers=20, min_share=0.3, min_matches=20),
        "of its two ends, low, as the search in the surroundings decides",
    )
    radius_px: float = setting(10.0, "half side of the window of that search, on level 0")
    min_matches: int = setting(40, "fewest points of the loop's surroundings matched in the keyframe")
    adjustment_iterations: int = setting(10, "steps of global bundle adjustment after a loop; 0 for none")


@dataclass(frozen=True)
class Refusal:
    """A loop that was verified and yet refused.

    Attributes:
        keyframe, loop_keyframe: rows.
        matches: points matched between them.
        reason: what speaks against it.
        believed: chance that it is right, if it was asked.
    """

    keyframe: int
    loop_keyframe: int
    matches: int
    reason: str
    believed: float | None = None


@dataclass(frozen=True)
class _Candidates:
    """A loop candidate with its neighbours, and the number of consecutive keyframes that proposed it."""

    keyframes: frozenset[int]
    count: int


class LoopDetector:
    """Detects loops at the keyframes of one map."""

    def __init__(
        self, map_: Map, database: KeyframeDatabase, config: LoopClosingConfig, beliefs: BeliefConfig | None
    ) -> None:
        self.map = map_
        self.config = config
        self._beliefs = beliefs
        self._supposed: list[Supposed] = []
        self._database = database
        self._groups: list[_Candidates] = []
        self._last_loop = 0

    def detect(
        self, keyframe: int, rng: np.random.Generator
    ) -> tuple[tuple[Loop, np.ndarray] | None, list[Refusal]]:
        """Detect a loop at a new keyframe, which need not be in the database yet.

        Args:
            keyframe: row; its covisibility is final.
            rng: stream of the RANSAC.

        Returns:
            The loop and (q,) int32 the points of its surroundings, None if there is no loop; and the loops
            that were refused.
        """
        refused: list[Refusal] = []
        recent = [s for s in self._supposed if keyframe - s.newest.new_keyframe < self.config.min_gap]
        self._supposed = recent
        for supposed in recent:
            supposed.look(self.map, keyframe)
        if keyframe - self._last_loop < self.config.min_gap or self.map.arrays.kf_bad[keyframe]:
            return None, refused
        for candidate in self._consistent(keyframe):
            found = self._verify(keyframe, candidate, rng)
            if isinstance(found, Refusal):
                refused.append(found)
            elif found is not None:
                return found, refused
        return None, refused

    def closed(self, loop: Loop) -> None:
        """Take over that a loop was closed."""
        self._last_loop, self._groups, self._supposed = loop.keyframe, [], []

    def is_believed(self, loop: Loop, before: Map, corrected: Map) -> bool:
        """Ask a map's corrected copy too, before it is adjusted; a loop that was not asked is believed."""
        if loop.supposed is None:
            return True
        loop.supposed.tear(before, torn(before, corrected))
        return loop.supposed.is_believed(self._supposed)

    def refused(self, loop: Loop, reason: str) -> Refusal:
        """What is told of a loop that is not closed."""
        return Refusal(loop.keyframe, loop.loop_keyframe, len(loop.points), reason, loop.believed)

    def _consistent(self, keyframe: int) -> list[int]:
        """Candidates whose surroundings were candidates at the previous keyframes too."""
        groups, accepted = [], []
        for candidate in self._database.loop_candidates(keyframe):
            mine = frozenset(int(k) for k in self.map.neighbours(candidate, self.map.n_keyframes)) | {
                candidate
            }
            count = 1 + max((g.count for g in self._groups if g.keyframes & mine), default=0)
            groups.append(_Candidates(mine, count))
            if count >= self.config.consistency:
                accepted.append(candidate)
        self._groups = groups
        return accepted

    def _verify(
        self, keyframe: int, candidate: int, rng: np.random.Generator
    ) -> tuple[Loop, np.ndarray] | Refusal | None:
        """Estimate the similarity of the two keyframes and check it on the surroundings of both."""
        m = self.map
        alignment, _, _ = align(m, m, candidate, keyframe, rng, self.config.alignment)
        if alignment is None:
            return None
        S_cam_map = m.T_cam_map(keyframe) @ sim3_inverse(alignment.S_old_new)
        around = self._surroundings(candidate)
        rows, points = self._extended(keyframe, alignment, S_cam_map, around)
        if len(points) < self.config.min_matches:
            return None
        loop = Loop(keyframe, candidate, S_cam_map, rows, points)
        if self._beliefs is not None:
            supposed = suppose(self._supposed, m, m, alignment, Agreement(), self._beliefs)
            loop = replace(loop, supposed=supposed)
            if not supposed.is_believed(self._supposed, hoping=True):
                told_once = supposed.believed < 0.5 and len(supposed.alignments) == 1
                return self.refused(loop, DISBELIEVED) if told_once else None
        return loop, around

    def _surroundings(self, candidate: int) -> np.ndarray:
        """(q,) int32 points that the candidate and its neighbours see."""
        keyframes = [candidate, *self.map.neighbours(candidate, self.map.n_keyframes)]
        points = np.unique(np.concatenate([self.map.observed_points(int(k)) for k in keyframes]))
        return points[points >= 0].astype(np.int32)

    def _extended(
        self, keyframe: int, alignment: Alignment, S_cam_map: np.ndarray, around: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Keypoints (by index in the keyframe) and the matched points of the surroundings."""
        m = self.map
        own = m.observed_points(keyframe)
        row_of = {int(p): i for i, p in enumerate(own) if p >= 0}
        rows = np.array([row_of[int(p)] for p in alignment.new_points], int)
        taken = np.zeros(len(own), np.bool_)
        taken[rows] = True
        candidates = np.setdiff1d(around, alignment.old_points).astype(np.int32)
        scale, _, _ = sim3_decompose(S_cam_map)
        matched = match_across(
            m.arrays, candidates, S_cam_map, scale, m.arrays, m.view, keyframe, taken, self.config.radius_px
        )
        hit = matched >= 0
        return (
            np.concatenate([rows, matched[hit]]),
            np.concatenate([alignment.old_points, candidates[hit]]).astype(np.int32),
        )
