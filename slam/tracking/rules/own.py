"""Our rules of tracking: ORB-SLAM's, with what measurements have added."""

import numpy as np

from dslab.slam.core.frame import Frame
from dslab.slam.map._map_kernels import count_observed
from dslab.slam.map.map import Map
from dslab.slam.matching import guided
from dslab.slam.places.evidence import support
from dslab.slam.tracking.local_map import (
    covered_share,
    local_map,
    match_keyframe,
    match_local,
    optimize_frame,
    points_of,
)
from dslab.slam.tracking.rules.interface import Gate, KeyframeChoice, Loss, Search, Tracking


def match_last(tracking: Tracking, frame: Frame, last: Frame, T_cam_map: np.ndarray, radius_px: float) -> int:
    """Match a frame with the last one's points around a pose; number of matches."""
    f, g = frame.features, last.features
    frame.point, count = guided.match_last_frame(
        tracking.map.arrays, tracking.map.view, T_cam_map, last.point, g.octave, g.angle_deg,
        f.xy, f.octave, f.angle_deg, f.descriptors, f.cell_start, radius_px,
    )  # fmt: skip
    return count


def track_reference_keyframe(
    tracking: Tracking, frame: Frame, last: Frame, ratio: float, least_matches: int, least_inliers: int
) -> bool:
    """Match a frame with the last reference keyframe's points without prediction."""
    keyframe = tracking.map.live(last.reference_keyframe)
    rows, points = match_keyframe(frame, tracking.map, keyframe, ratio)
    frame.point[:] = -1
    if len(rows) < least_matches:
        return False
    frame.point[rows] = points
    frame.T_cam_map = last.T_cam_map.copy()
    return tracking.optimize(frame) >= least_inliers


class OwnSearch(Search):
    """Windows around the predicted pose, wider ones after a gap."""

    def predict(self, tracking: Tracking, frame: Frame, last: Frame) -> bool:
        """Find a first pose by the motion model or across a gap; if that fails by the reference keyframe."""
        config = tracking.config
        if tracking.passed_over:
            found = self._across_gap(tracking, frame, last)
        else:
            found = self._by_motion(tracking, frame, last)
        bounds = config.reference_ratio, config.min_reference_matches, config.min_motion_inliers
        return found or track_reference_keyframe(tracking, frame, last, *bounds)

    def match_local_map(self, tracking: Tracking, frame: Frame) -> int:
        """Match a frame with its local map."""
        m, config = tracking.map, tracking.config
        keyframes, points = local_map(m, frame.point, config.local_map_keyframes)
        if not len(keyframes):
            return -1
        match_local(frame, m, points, 1.0, config.local_map_ratio, tracking.observing)
        return int(keyframes[0])

    def _by_motion(self, tracking: Tracking, frame: Frame, last: Frame) -> bool:
        config = tracking.config
        if tracking.velocity is None:
            return False
        predicted = np.ascontiguousarray(tracking.velocity @ last.T_cam_map)
        count = 0
        for widen in (1.0, 2.0):
            count = match_last(tracking, frame, last, predicted, widen * config.search_radius_px)
            if count >= config.min_motion_matches:
                break
        if count < config.min_motion_matches:
            return False
        frame.T_cam_map = predicted
        return tracking.optimize(frame) >= config.min_motion_inliers

    def _across_gap(self, tracking: Tracking, frame: Frame, last: Frame) -> bool:
        """Match the local map around the predicted pose and the last reference keyframe's.

        A pose predicted over many frames may be far off, and the few points of a plane may then fit a wrong
        pose. The keyframe's pose is reliable: bundle adjustment has refined it. Of the two starts, the one
        with more inliers is used.
        """
        if tracking.velocity is None:
            return False
        m, config = tracking.map, tracking.config
        starts = tracking.velocity @ last.T_cam_map, m.T_cam_map(m.live(last.reference_keyframe))
        _, points = local_map(m, last.point, config.local_map_keyframes)
        least = config.min_motion_matches
        for radius_px in config.gap_radius_px * np.array([1.0, 2.0, 4.0]):
            found = [self._about(tracking, frame, T, points, radius_px, least) for T in starts]
            best = max(found, key=lambda placed: placed[0])
            if best[0] >= least:
                _, frame.T_cam_map, frame.point = best
                return True
        return False

    def _about(
        self,
        tracking: Tracking,
        frame: Frame,
        T_cam_map: np.ndarray,
        points: np.ndarray,
        radius_px: float,
        least: int,
    ) -> tuple[int, np.ndarray, np.ndarray]:
        """Inliers, pose and matches of a frame with points projected by an assumed pose."""
        frame.point = np.full(len(frame.features), -1, np.int32)
        frame.T_cam_map = np.ascontiguousarray(T_cam_map)
        ratio = tracking.config.local_map_ratio
        enough = match_local(frame, tracking.map, points, radius_px / 4.0, ratio) >= least
        inliers = tracking.optimize(frame) if enough else 0
        return inliers, frame.T_cam_map, frame.point


class OwnGate(Gate):
    """χ² of the errors over the noise that the frame itself shows, within bounds."""

    def optimize(self, tracking: Tracking, frame: Frame) -> int:
        """Refine a frame's pose, at a noise up to ``max_noise`` times the usual."""
        return optimize_frame(frame, tracking.map, tracking.config.max_noise)


class OwnLoss(Loss):
    """A count of inliers, more of them in smeared frames and behind a gap, and what the view says there."""

    def least_inliers(self, tracking: Tracking, frame: Frame, usual: int) -> int:
        """Inliers that a pose must have: ``usual``, or more behind a gap.

        Those of a smeared image say less of its pose each, so that more are asked.
        """
        least = max(usual, tracking.config.cautious_inliers) if tracking.passed_over else usual
        return round(least * frame.noise)

    def fault(self, tracking: Tracking, frame: Frame, last: Frame, inliers: int, matches: int) -> str:
        """Why a frame counts as lost."""
        config = tracking.config
        if inliers < self.least_inliers(tracking, frame, config.min_inliers):
            return "too_few_local_map_inliers"
        if inliers < config.min_share * matches:
            return "too_many_outliers"
        return self.fault_of_view(tracking, frame, last)

    def fault_of_view(self, tracking: Tracking, frame: Frame, last: Frame) -> str:
        """What the view says against its pose after a gap; empty for nothing, or without a gap.

        A distant wall that both views show fits any displacement, and what looks alike fits a wrong one.
        """
        if not tracking.passed_over:
            return ""
        m, config = tracking.map, tracking.config.crossing
        k = m.live(last.reference_keyframe)
        points = points_of(m, [k, *map(int, m.neighbours(k, config.around))])
        seen = support(m, points, frame.T_cam_map, frame.features, config.radius_px)
        return config.bar.fault(seen) if seen.expected >= config.min_expected else ""


class OwnKeyframeChoice(KeyframeChoice):
    """Too few of the reference keyframe's points, or found on one side only."""

    def may(self, tracking: Tracking, frame: Frame, mapping_is_idle: bool) -> bool:
        """Return True if mapping is idle and the least interval since the last keyframe is over."""
        last = tracking.last_keyframe
        waited_s = np.inf if last is None else abs(frame.features.stamp_s - last.stamp_s)
        return mapping_is_idle and waited_s > tracking.config.keyframe_interval_s - 1e-6

    def wants(self, tracking: Tracking, frame: Frame, inliers: int, mapping_is_idle: bool) -> bool:
        """Return True if the frame may, and sees too few of its reference keyframe's points."""
        config, last = tracking.config, tracking.last_keyframe
        if not self.may(tracking, frame, mapping_is_idle):
            return False
        known = known_points(tracking.map, frame)
        right_behind = last is not None and abs(frame.features.index - last.index) == 1
        if right_behind:
            return inliers < max(config.urgent_share * known, config.urgent_inliers)
        held = inliers >= config.keyframe_share * known
        return not held or covered_share(frame, tracking.map) < config.keyframe_cover


def known_points(map_: Map, frame: Frame) -> int:
    """Number of the reference keyframe's points that three keyframes see, two in a map of two."""
    return count_observed(map_.arrays, frame.reference_keyframe, 3 if map_.n_keyframes > 2 else 2)
