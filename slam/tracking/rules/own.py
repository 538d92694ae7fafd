"""Rules of tracking that follow from covariances: of the pose, of the points, of the keypoints.

Where a point is sought, whether a keypoint shows it, at which noise, and whether the pose is known: all from
one model. docs/base-decides.md has the formulas.
"""

from dataclasses import replace

import numpy as np

from dslab.slam.association.placing import (
    LEAST_RIGHT,
    NOTHING,
    Sighted,
    evidence_of_view,
    refine,
    take_matches,
)
from dslab.slam.core._frame_kernels import median_depth
from dslab.slam.core.frame import Frame
from dslab.slam.core.results import RelativePose
from dslab.slam.map._covariance_kernels import relative_covariance
from dslab.slam.map.map import Map
from dslab.slam.optimization.student import INFORMATION
from dslab.slam.tracking.local_map import local_map, points_of
from dslab.slam.tracking.rules.interface import Gate, KeyframeChoice, Loss, Search, Tracking
from dslab.slam.tracking.rules.reference import track_reference_keyframe

_FIRST = 100
"""Points of the last frame that are matched first: enough for the pose that the others are sought by."""
_WIDER = 1.0, 9.0, 81.0
"""Factors of the predicted variance that are tried: a model of motion has heavier tails than a normal."""
_LEAST_CELLS = 3
"""In which there must be points: those of one place leave a pose open."""
_MOST_DRAWN = 5.28
"""Standard deviations by which a pose may move without the cell that tells most. By chance one in 10,000
does, by χ² of six degrees of freedom."""
_BEHIND_A_GAP = 9.2
"""Log of the odds that a view behind a gap must show: nothing else says that it is there; one in 10,000."""
_AROUND = 10
"""Neighbours of a keyframe whose points a view of its place should show."""


class OwnSearch(Search):
    """Windows of 99 % by the covariances of pose, point and keypoint; matches by their posterior."""

    def predict(self, tracking: Tracking, frame: Frame, last: Frame) -> bool:
        """Find a first pose by some points of the last frame; without a motion by the reference keyframe."""
        if self._by_motion(tracking, frame, last):
            return True
        return track_reference_keyframe(tracking, OwnGate(), frame, last, LEAST_RIGHT, LEAST_RIGHT)

    def seek(self, map_: Map, frame: Frame, points: np.ndarray, observing: bool) -> None:
        """Match a frame anew, as its pose and that one's covariance say."""
        take_matches(map_, frame, points, frame.covariance, observing)

    def learn(self, tracking: Tracking, frame: Frame, last: Frame) -> None:
        """Note how far the motion model was off, and the noise."""
        m = tracking.map
        if tracking.velocity is not None and np.isfinite(frame.depth):
            tracking.motion.note(tracking.velocity @ last.T_cam_map, frame.T_cam_map, frame.depth)
        tracking.sharpest = min(tracking.sharpest, variance(frame))
        frame.features = replace(frame.features, noise2=frame.noise2)
        if tracking.observing:
            m.noise.note(frame.noise2)

    def _by_motion(self, tracking: Tracking, frame: Frame, last: Frame) -> bool:
        if tracking.velocity is None:
            return False
        m = tracking.map
        steps = tracking.passed_over + 1
        start = np.ascontiguousarray(tracking.velocity @ last.T_cam_map)
        known = last.point[last.point >= 0]
        if not len(known):
            return False
        if steps > 1 or len(known) < _FIRST:
            _, known = local_map(m, last.point, tracking.config.local_map_keyframes)
        else:
            known = np.ascontiguousarray(known[:: max(len(known) // _FIRST, 1)])
        spread = tracking.motion.predicted(
            last.covariance, steps, median_depth(m.arrays.pt_xyz[known], start)
        )
        for wider in _WIDER:
            frame.T_cam_map, frame.noise2 = start.copy(), m.noise2
            take_matches(m, frame, known, wider * spread)
            if refine(m, frame, np.linalg.inv(wider * spread))[0] >= LEAST_RIGHT:
                return True
        return False


class OwnGate(Gate):
    """Pose, noise and right matches by expectation maximisation."""

    def refine(self, map_: Map, frame: Frame, also: Sighted = NOTHING) -> tuple[int, np.ndarray]:
        """Refine a frame's pose; matches that are more likely wrong than right are taken from it."""
        return refine(map_, frame, also=also)

    def relative(self, map_: Map, frame: Frame) -> RelativePose | None:
        """Points, keyframe and its neighbours are as uncertain as their observations leave them."""
        k = frame.reference_keyframe
        rows = np.flatnonzero(frame.point >= 0)
        covariance = relative_covariance(
            map_.arrays, map_.view, map_.n_keyframes, k, frame.T_cam_map, frame.point[rows],
            frame.features.octave[rows], map_.noise2, frame.noise2 / INFORMATION,
        )  # fmt: skip
        return RelativePose(
            map_.frame_index(k), frame.T_cam_map @ np.linalg.inv(map_.T_cam_map(k)), covariance
        )


class OwnLoss(Loss):
    """The pose is not known, hangs on one place, rests on too few points, or the view says that it is not."""

    least_inliers = LEAST_RIGHT

    def fault(self, tracking: Tracking, frame: Frame, last: Frame, inliers: int) -> str:
        """Why a frame counts as lost."""
        if inliers < LEAST_RIGHT or frame.cells < _LEAST_CELLS:
            return "too_few_local_map_inliers"
        if frame.relative is None or _largest(frame.relative, frame) > tracking.config.max_uncertainty:
            return "uncertain_pose"
        if frame.drawn > _MOST_DRAWN:
            return "one_place_decides"
        least = _BEHIND_A_GAP if tracking.passed_over else 0.0
        return "view_disagrees" if frame.evidence < least else ""

    def fault_of_view(self, tracking: Tracking, frame: Frame, last: Frame) -> str:
        """What the points that a view behind a gap should show say against its pose, however it was found."""
        if not tracking.passed_over:
            return ""
        m = tracking.map
        k = m.live(last.reference_keyframe)
        points = points_of(m, [k, *map(int, m.neighbours(k, _AROUND))])
        return "view_disagrees" if evidence_of_view(m, frame, points) < _BEHIND_A_GAP else ""


class OwnKeyframeChoice(KeyframeChoice):
    """The information about the pose has fallen since the last keyframe."""

    def may(self, tracking: Tracking, frame: Frame, mapping_is_idle: bool) -> bool:
        """Return True if mapping is idle and the least interval since the last keyframe is over."""
        last = tracking.last_keyframe
        waited_s = np.inf if last is None else abs(frame.features.stamp_s - last.stamp_s)
        return mapping_is_idle and waited_s > tracking.config.keyframe_interval_s - 1e-6

    def wants(self, tracking: Tracking, frame: Frame, inliers: int, mapping_is_idle: bool) -> bool:
        """Return True if the frame may, and tells less of its pose than the best one since the last."""
        if not self.may(tracking, frame, mapping_is_idle):
            return False
        config, last = tracking.config, tracking.last_keyframe
        right_behind = last is not None and abs(frame.features.index - last.index) == 1
        share = config.urgent_information if right_behind else config.keyframe_information
        return tracking.sharpest < share * variance(frame)


def variance(frame: Frame) -> float:
    """Variance of a frame's pose at the usual noise: what it sees decides, not how sharply.

    Of direction, rad², or of position, squared median depths: the larger, along the axis in which it is most.
    """
    known = RelativePose(0, frame.T_cam_map, frame.covariance)
    return _largest(known, frame) ** 2 / frame.noise2


def _largest(pose: RelativePose, frame: Frame) -> float:
    return max(pose.position_sd / frame.depth, pose.direction_sd_rad)
