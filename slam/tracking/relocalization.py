"""Relocalization: recognise a mapped place from a single frame and estimate its pose.

Source: Mur-Artal, Montiel, Tardos, "ORB-SLAM", 2015, section V-C.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from dslab.slam.belief.model import come
from dslab.slam.core.frame import Frame
from dslab.slam.core.geometry import camera_centre
from dslab.slam.core.settings import DEPTHS, setting, settings
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.map import Map
from dslab.slam.places.recognition import KeyframeDatabase
from dslab.slam.tracking.local_map import local_map, match_keyframe
from dslab.slam.tracking.pnp import ransac_pnp
from dslab.slam.tracking.reach import Reach
from dslab.slam.tracking.rules.interface import Rules

_UNLIKELY = 3.0
"""Places to which a camera has come less than a twentieth (e⁻³) as likely as to another are left out."""


@settings
class RelocalizationConfig:
    """Thresholds of relocalization."""

    candidates: int = setting(5, "most similar keyframes tried per frame, the most similar first")
    last_keyframe: bool = setting(True, "try the last keyframe before the loss too, however similar")
    ratio: float = setting(0.75, "best over second best distance of an unguided match", le=1)
    min_matches: int = setting(15, "unguided matches with a keyframe's points, below which it is not tried")
    ransac_iterations: int = setting(300, "most samples of the RANSAC of a pose from three points")
    ransac_error_px: float = setting(5.0, "largest error of an inlier; level 0")
    min_pose_inliers: int = setting(10, "fewest inliers of a pose that is used further")
    min_inliers: int = setting(50, "map matches that survive pose optimisation, for the place to be accepted")
    local_map_keyframes: int = setting(20, "most keyframes of the local map searched")
    min_margin: float = setting(1.3, "inliers of the best place over any other: look-alikes are not taken")
    apart: float = setting(0.2, "distance from which two poses are two places", unit=DEPTHS)
    apart_deg: float = setting(10.0, "angle from which two poses are two places")


@dataclass(frozen=True)
class RelocalizationOutcome:
    """Outcome of relocalizing one frame.

    Attributes:
        success: the frame has a pose in the map, matches and a reference keyframe.
        keyframe: the candidate used, -1 for none.
        inliers: map matches of the pose; of the best attempt if all failed.
        matches: matches of that attempt, before its last pose optimisation.
        reason: reason of the failure, of the attempt that came farthest; empty on success.
    """

    success: bool
    keyframe: int
    inliers: int
    matches: int
    reason: str = ""


_FAILURES = (
    "no_candidates",
    "too_few_matches",
    "no_pose",
    "too_few_pose_inliers",
    "too_few_inliers",
    "ambiguous",
)


@dataclass(frozen=True)
class _Place:
    """A place where a frame fits: its outcome, pose and matches there."""

    outcome: RelocalizationOutcome
    T_cam_map: np.ndarray
    point: np.ndarray


class Relocalizer:
    """Relocalizes single frames in one map, by the search and the gate of tracking."""

    def __init__(
        self, map_: Map, database: KeyframeDatabase, config: RelocalizationConfig, rules: Rules
    ) -> None:
        self.map = map_
        self._rules = rules
        self.config = config
        self._database = database

    def relocalize(
        self,
        frame: Frame,
        rng: np.random.Generator,
        reach: Reach | None = None,
        similar: Sequence[int] | None = None,
        also: Sequence[int] = (),
    ) -> RelocalizationOutcome:
        """Try the most similar keyframes; of several places, take the one that fits clearly best.

        Args:
            frame: features only; pose, matches and reference keyframe are set on success and left unknown
                on failure.
            rng: stream of the RANSAC.
            reach: where the camera can be; places there are preferred to any beyond. None for anywhere.
            similar: keyframes that are tried, the most similar first; None to look them up.
            also: keyframes tried after them, however similar.
        """
        farthest = RelocalizationOutcome(False, -1, 0, 0, "no_candidates")
        places: list[_Place] = []
        if similar is None:
            bow = self._database.vocabulary.transform(frame.features.descriptors)
            similar = self._database.relocalization_candidates(bow)
        for keyframe in dict.fromkeys([*similar[: self.config.candidates], *also]):
            outcome = self._try(frame, keyframe, rng)
            if outcome.success:
                places.append(_Place(outcome, frame.T_cam_map.copy(), frame.point.copy()))
            farthest = max(farthest, outcome, key=_progress)
        if places:
            outcome = self._clearly_best(frame, self._likeliest(frame, places, reach))
            if outcome.success:
                return outcome
            farthest = outcome
        frame.point[:] = -1
        frame.T_cam_map = np.full((4, 4), np.nan)
        return farthest

    def _likeliest(self, frame: Frame, places: list[_Place], reach: Reach | None) -> list[_Place]:
        """Those to which a camera has come about as likely as to any other."""
        if reach is None:
            return places
        chances = []
        for place in places:
            depth = kernels.median_depth(self.map.arrays, place.outcome.keyframe)
            centre = camera_centre(place.T_cam_map)
            chances.append(come(reach.unseen(centre, frame.features.stamp_s, depth)))
        return [p for p, chance in zip(places, chances, strict=True) if chance > max(chances) - _UNLIKELY]

    def _clearly_best(self, frame: Frame, places: list[_Place]) -> RelocalizationOutcome:
        """Place the frame where it fits best, if it fits clearly less anywhere else."""
        best = max(places, key=lambda place: place.outcome.inliers)
        depth = kernels.median_depth(self.map.arrays, best.outcome.keyframe)
        others = [p.outcome.inliers for p in places if self._are_apart(best, p, depth)]
        if others and best.outcome.inliers < self.config.min_margin * max(others):
            return replace(best.outcome, success=False, reason="ambiguous")
        frame.T_cam_map, frame.point[:] = best.T_cam_map, best.point
        self._set_reference(frame)
        return best.outcome

    def _are_apart(self, one: _Place, other: _Place, depth: float) -> bool:
        T = one.T_cam_map @ np.linalg.inv(other.T_cam_map)
        angle_deg = np.rad2deg(np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1)))
        far = np.linalg.norm(T[:3, 3]) > self.config.apart * depth
        return bool(far or angle_deg > self.config.apart_deg)

    # -- steps -------------------------------------------------------------------------------------------

    def _try(self, frame: Frame, keyframe: int, rng: np.random.Generator) -> RelocalizationOutcome:
        """Match unguided, estimate a pose from three points, match guided."""
        rows, points = match_keyframe(frame, self.map, keyframe, self.config.ratio)
        matches = len(rows)
        if matches < self.config.min_matches:
            return RelocalizationOutcome(False, keyframe, 0, matches, "too_few_matches")
        found = ransac_pnp(
            self.map.arrays.pt_xyz[points], frame.features.xy[rows], self.map.view, rng,
            self.config.ransac_iterations, self.config.ransac_error_px, self.config.min_pose_inliers,
            cv2.SOLVEPNP_AP3P, 0.99,
        )  # fmt: skip
        if found is None:
            return RelocalizationOutcome(False, keyframe, 0, matches, "no_pose")
        frame.T_cam_map, agree = found
        frame.point[:], frame.area[:] = -1, 0.0
        frame.point[rows[agree]] = points[agree]
        inliers, _ = self._rules.gate.refine(self.map, frame)
        if inliers < self.config.min_pose_inliers:
            return RelocalizationOutcome(False, keyframe, inliers, matches, "too_few_pose_inliers")
        if inliers < self.config.min_inliers:
            matches, inliers = self._search(frame)
        if inliers < self.config.min_inliers:
            return RelocalizationOutcome(False, keyframe, inliers, matches, "too_few_inliers")
        return RelocalizationOutcome(True, keyframe, inliers, matches)

    def _search(self, frame: Frame) -> tuple[int, int]:
        """Match the local map around the pose and refine it; (matches, inliers)."""
        _, points = local_map(self.map, frame.point, self.config.local_map_keyframes)
        self._rules.search.seek(self.map, frame, points, False)
        matches = int((frame.point >= 0).sum())
        return matches, self._rules.gate.refine(self.map, frame)[0]

    def _set_reference(self, frame: Frame) -> None:
        """Refer the frame to the keyframe that shares most of its points."""
        m = self.map
        keyframes, _ = local_map(m, frame.point, 1)
        frame.reference_keyframe = int(keyframes[0])
        frame.T_cam_reference = frame.T_cam_map @ np.linalg.inv(m.T_cam_map(frame.reference_keyframe))


def _progress(outcome: RelocalizationOutcome) -> tuple[int, int]:
    return _FAILURES.index(outcome.reason) if outcome.reason else len(_FAILURES), outcome.inliers
