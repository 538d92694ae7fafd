"""Rules of tracking that follow from covariances: of the pose, of the points, of the keypoints.

Where a point is sought, whether a keypoint shows it, at which noise, and whether the pose is known: all from
one model. docs/notebook/base-decides.md has the formulas and what was measured.
"""

from dataclasses import replace

import numpy as np

from dslab.slam.association._kernels import associate, density_of
from dslab.slam.association.descriptors import odds_by_distance
from dslab.slam.core.frame import Frame
from dslab.slam.core.results import RelativePose
from dslab.slam.map._covariance_kernels import relative_covariance
from dslab.slam.optimization.student import CHI2_99, INFORMATION
from dslab.slam.optimization.uncertain_pose import uncertain_pose
from dslab.slam.tracking.local_map import local_map, median_depth, points_of
from dslab.slam.tracking.rules.interface import Gate, Loss, Search, Tracking
from dslab.slam.tracking.rules.own import OwnKeyframeChoice, track_reference_keyframe

_FIRST = 100
"""Points of the last frame that are matched first: enough for the pose that the others are sought by."""
_WIDER = 1.0, 9.0, 81.0
"""Factors of the predicted variance that are tried: a model of motion has heavier tails than a normal."""
_LIKELIER_THAN_NOT = 0.5
_LEAST_RIGHT, _LEAST_CELLS = 12.0, 3
"""Fewer matches tell no pose, whatever their covariance says: chance fits a few."""
_CELLS = 8
_MOST_DRAWN = 5.28
"""Standard deviations by which a pose may move without the cell that tells most. By chance one in 10,000
does, by χ² of six degrees of freedom."""
_BEHIND_A_GAP = 9.2
"""Log of the odds that a view behind a gap must show: nothing else says that it is there; one in 10,000."""
_AROUND = 10
"""Neighbours of a keyframe whose points a view of its place should show."""


class DerivedSearch(Search):
    """Windows of 99 % by the covariances of pose, point and keypoint; matches by their posterior."""

    def predict(self, tracking: Tracking, frame: Frame, last: Frame) -> bool:
        """Find a first pose by some points of the last frame; without a motion by the reference keyframe."""
        config = tracking.config
        bounds = config.reference_ratio, config.min_reference_matches, config.min_motion_inliers
        if self._by_motion(tracking, frame, last):
            return True
        frame.area[:] = 0.0
        return track_reference_keyframe(tracking, frame, last, *bounds)

    def match_local_map(self, tracking: Tracking, frame: Frame) -> int:
        """Match a frame anew with its local map, as its first pose and that one's covariance say."""
        keyframes, points = local_map(tracking.map, frame.point, tracking.config.local_map_keyframes)
        if not len(keyframes):
            return -1
        _match(tracking, frame, points, frame.covariance, tracking.observing)
        return int(keyframes[0])

    def learn(self, tracking: Tracking, frame: Frame, last: Frame) -> None:
        """Note how far the motion model was off, and the noise."""
        m = tracking.map
        if tracking.velocity is not None and (frame.point >= 0).any():
            tracking.motion.note(tracking.velocity @ last.T_cam_map, frame.T_cam_map, median_depth(frame, m))
        tracking.sharpest = min(tracking.sharpest, variance(tracking, frame))
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
        spread = tracking.motion.predicted(last.covariance, steps, _depth(m, known, start))
        for wider in _WIDER:
            frame.T_cam_map, frame.noise2 = start.copy(), m.noise2
            _match(tracking, frame, known, wider * spread, False)
            if _right(tracking, frame, np.linalg.inv(wider * spread)) >= _LEAST_RIGHT:
                return True
        return False


class DerivedGate(Gate):
    """Pose, noise and right matches by expectation maximisation."""

    def optimize(self, tracking: Tracking, frame: Frame) -> int:
        """Refine a frame's pose; matches that are more likely wrong than right are taken from it."""
        return _right(tracking, frame, np.zeros((6, 6)))

    def relative(self, tracking: Tracking, frame: Frame) -> RelativePose | None:
        """Points, keyframe and its neighbours are as uncertain as their observations leave them."""
        m, k = tracking.map, frame.reference_keyframe
        rows = np.flatnonzero(frame.point >= 0)
        covariance = relative_covariance(
            m.arrays, m.view, m.n_keyframes, k, frame.T_cam_map, frame.point[rows],
            frame.features.octave[rows], m.noise2, frame.noise2 / INFORMATION,
        )  # fmt: skip
        return RelativePose(m.frame_index(k), frame.T_cam_map @ np.linalg.inv(m.T_cam_map(k)), covariance)


class DerivedLoss(Loss):
    """The pose is not known, hangs on one place, rests on too few points, or the view says that it is not."""

    def least_inliers(self, tracking: Tracking, frame: Frame, usual: int) -> int:
        """A floor, in place of ``usual``."""
        return int(_LEAST_RIGHT)

    def fault(self, tracking: Tracking, frame: Frame, last: Frame, inliers: int, matches: int) -> str:
        """Why a frame counts as lost."""
        if inliers < _LEAST_RIGHT or _cells(tracking, frame) < _LEAST_CELLS:
            return "too_few_local_map_inliers"
        if _uncertainty(tracking, frame) > tracking.config.max_uncertainty:
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
        _, _, evidence = _associated(tracking, frame, points, frame.covariance, False)
        return "view_disagrees" if evidence < _BEHIND_A_GAP else ""


class DerivedKeyframeChoice(OwnKeyframeChoice):
    """The information about the pose has fallen since the last keyframe."""

    def wants(self, tracking: Tracking, frame: Frame, inliers: int, mapping_is_idle: bool) -> bool:
        """Return True if the frame may, and tells less of its pose than the best one since the last."""
        if not self.may(tracking, frame, mapping_is_idle):
            return False
        config, last = tracking.config, tracking.last_keyframe
        right_behind = last is not None and abs(frame.features.index - last.index) == 1
        share = config.urgent_information if right_behind else config.keyframe_information
        return tracking.sharpest < share * variance(tracking, frame)


def variance(tracking: Tracking, frame: Frame) -> float:
    """Variance of a frame's pose at the usual noise: what it sees decides, not how sharply.

    Of direction, rad², or of position, squared median depths: the larger, along the axis in which it is most.
    """
    known = RelativePose(0, frame.T_cam_map, frame.covariance)
    return _largest(known, median_depth(frame, tracking.map)) ** 2 / frame.noise2


def _uncertainty(tracking: Tracking, frame: Frame) -> float:
    """Standard deviation relative to the reference keyframe, as in :func:`variance`."""
    if frame.relative is None:
        return np.inf
    return _largest(frame.relative, median_depth(frame, tracking.map))


def _largest(pose: RelativePose, depth: float) -> float:
    return max(pose.position_sd / depth, pose.direction_sd_rad)


def _match(
    tracking: Tracking, frame: Frame, points: np.ndarray, covariance: np.ndarray, observing: bool
) -> None:
    """Take the matches of a frame with some points about its pose, and what they say of it."""
    frame.sought = frame.T_cam_map.copy(), covariance.copy()
    found = _associated(tracking, frame, points, covariance, observing)
    frame.point, frame.area, frame.evidence = found


def _associated(
    tracking: Tracking, frame: Frame, points: np.ndarray, covariance: np.ndarray, observing: bool
) -> tuple[np.ndarray, np.ndarray, float]:
    m, f = tracking.map, frame.features
    view = m.view
    image = (view.x_max - view.x_min) * (view.y_max - view.y_min)
    return associate(
        m.arrays, view, frame.T_cam_map, covariance, _noise2(tracking, frame), points, f.xy, f.octave,
        f.descriptors, f.cell_start, density_of(f.octave, len(view.scale), image), odds_by_distance(),
        _LIKELIER_THAN_NOT, observing,
    )  # fmt: skip


def _noise2(tracking: Tracking, frame: Frame) -> float:
    """Variance of a frame's keypoints, as far as it has told it; else that of the map's."""
    return tracking.map.noise2 if np.isnan(frame.noise2) else frame.noise2


def _right(tracking: Tracking, frame: Frame, prior: np.ndarray) -> int:
    """Refine a frame's pose from its matches; number of those that are more likely right than wrong."""
    m, f = tracking.map, frame.features
    rows = np.flatnonzero(frame.point >= 0)
    points, view = frame.point[rows], m.view
    image = (view.x_max - view.x_min) * (view.y_max - view.y_min)
    area = np.where(frame.area[rows] > 0, frame.area[rows], image)
    inv_sigma2 = view.inv_sigma2[f.octave[rows]]
    own = _noise2(tracking, frame) / inv_sigma2
    spread = float(np.median(np.maximum(area / (np.pi * CHI2_99) - own, 0.0))) if len(rows) else 0.0
    found = uncertain_pose(
        frame.T_cam_map, m.arrays.pt_xyz[points], m.arrays.pt_covariance[points], f.xy[rows],
        inv_sigma2, area, m.noise2, spread, prior, view.intrinsics,
        (view.x_max - view.x_min) / _CELLS,
    )  # fmt: skip
    right = found.right > _LIKELIER_THAN_NOT
    frame.T_cam_map, frame.covariance, frame.drawn = found.T_cam_map, found.covariance, found.drawn
    frame.noise2, frame.noise = found.noise2, max(float(np.sqrt(found.noise2)), 1.0)
    frame.point[rows[~right]] = -1
    return int(right.sum())


def _depth(m, points: np.ndarray, T_cam_map: np.ndarray) -> float:
    """Median depth of some points from a pose, map units."""
    depth = m.arrays.pt_xyz[points] @ T_cam_map[2, :3] + T_cam_map[2, 3]
    ahead = depth[depth > 0]
    return float(np.median(ahead)) if len(ahead) else 1.0


def _cells(tracking: Tracking, frame: Frame) -> int:
    view = tracking.map.view
    side = (view.x_max - view.x_min) / _CELLS
    xy = frame.features.xy[frame.point >= 0]
    column, row = (xy // side).astype(int).T
    return len(np.unique(row * 2 * _CELLS + column))
