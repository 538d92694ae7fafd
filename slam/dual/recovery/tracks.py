"""What recovery threads share that follow features of their own beside the map's: pose, depth, tracks."""

import numpy as np

from dslab.slam.association.placing import Sighted
from dslab.slam.core.frame import Frame
from dslab.slam.core.settings import setting, settings
from dslab.slam.core.timing import StageTimer
from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryTask
from dslab.slam.dual.recovery.track_mapping import TrackMapper
from dslab.slam.features.tracks import TrackedFrame, rays, take_depth_from_points, triangulate_pairs
from dslab.slam.map._map_kernels import count_observed, resolve_points
from dslab.slam.optimization.pose import CHI2_2DOF
from dslab.slam.tracking.local_map import local_map
from dslab.slam.tracking.tracker import Tracker, TrackingOutcome

_HELD = 0.9
"""Inliers below this share of what the keyframe of a young map shows make one: section V-E of ORB-SLAM."""


@settings
class TrackRecoveryConfig(RecoveryConfig):
    """Settings of a thread with features of its own."""

    min_points: int = setting(15, "fewest map points that are inliers of a pose")
    min_features: int = setting(20, "fewest features that are inliers of a pose")
    min_features_alone: int = setting(60, "fewest feature inliers with fewer than min_points")
    young_points: int = setting(50, "points seen three times, below which a map is young")
    min_parallax_deg: float = setting(1.15, "least angle between the rays that triangulate a feature")
    depth_radius_px: float = setting(
        6.0, "largest distance to a keypoint that gives a feature its depth; grows beyond 640 px"
    )
    adjusted_keyframes: int = setting(10, "newest keyframes whose features are adjusted")
    paired_keyframes: int = setting(4, "newest keyframes matched without covisibility")


class TrackTracker(Tracker):
    """Places frames by features that are followed from frame to frame, then matches the map's ORB features.

    A feature takes its depth from a nearby map point at first; once there is parallax with the frame that
    saw it first, it is triangulated. Positions are kept relative to the last frame that saw them and so
    follow the map when bundle adjustment moves it.

    Attributes:
        latest: the last placed frame.
        keyframe_view: the last keyframe.
    """

    def __init__(self, task: RecoveryTask, config: TrackRecoveryConfig, first: TrackedFrame) -> None:
        super().__init__(task.new_map, config.tracking_in(task), StageTimer(), task.motion)
        self._thread_config = config
        self._radius_px = config.depth_radius_px * max(1.0, task.camera.width_px / 640)
        self._placed: list[Frame] = []
        self._tracks = 0
        self.latest = self.keyframe_view = first
        self.start(first.frame, first.frame.reference_keyframe)
        self.register(first)

    def mapper(self, task: RecoveryTask, start: int = 0) -> TrackMapper:
        """Local mapping from a keyframe on, with the features of the placed frames that become keyframes."""
        config = self._thread_config
        return TrackMapper(
            self.map,
            config.mapping_in(task),
            self.latest,
            lambda: self.latest,
            config.adjusted_keyframes,
            config.paired_keyframes,
            start,
        )

    def pass_over(self, frame: Frame) -> None:
        """Skip an unusable frame: the next one is compared with the same frame."""
        self.passed_over += 1

    def wants_keyframe(self, frame: Frame, inliers: int, mapping_is_idle: bool = True) -> bool:
        """Decide as forward tracking does, but earlier where the map is young or ends."""
        if not self.rules.keyframe.may(self, frame, mapping_is_idle):
            return False
        if inliers < self._thread_config.min_points:
            return True
        if count_observed(self.map.arrays, frame.reference_keyframe, 3) < self._thread_config.young_points:
            known = count_observed(self.map.arrays, frame.reference_keyframe, 2)
            return inliers < _HELD * known
        return super().wants_keyframe(frame, inliers, mapping_is_idle)

    def keyframe_made(self, frame: Frame, keyframe: int) -> None:
        """Take over that ``frame``, the last placed one, has become ``keyframe``."""
        super().keyframe_made(frame, keyframe)
        self.keyframe_view = self.latest

    def confirm(
        self, tracked: TrackedFrame, reference: TrackedFrame, xyz: np.ndarray, rows: np.ndarray
    ) -> tuple[TrackingOutcome, np.ndarray]:
        """Refine a pose by the map too; if it holds, the frame is the last one from now on.

        Args:
            tracked: the frame, with a pose.
            reference: the frame that it was compared with.
            xyz, rows: (k, 3) positions of the features ``rows``.

        Returns:
            The outcome, and (k,) bool mask of the features that agree.
        """
        config, frame = self._thread_config, tracked.frame
        resolve_points(self.map.arrays, reference.frame.point)
        agree, points, matches = self.match_map(tracked, reference.frame.point, xyz, rows)
        features = int(agree.sum())
        alone = points < config.min_points
        if features < (config.min_features_alone if alone else config.min_features):
            return TrackingOutcome(False, points, matches, "too_few_inliers"), agree
        fault = self.rules.loss.fault_of_view(self, frame, reference.frame)
        if fault:
            return TrackingOutcome(False, points, matches, fault), agree
        if alone:
            frame.point[:] = -1
        self.set_reference(frame, reference.frame)
        self._accept(frame, reference.frame)
        return TrackingOutcome(True, points, matches), agree

    # -- steps -------------------------------------------------------------------------------------------

    def match_map(
        self, tracked: TrackedFrame, seen: np.ndarray, xyz: np.ndarray, rows: np.ndarray
    ) -> tuple[np.ndarray, int, int]:
        """Match the local map around the pose and refine it by both kinds of features.

        Args:
            tracked: the frame, with a pose.
            seen: map points that the reference frame sees, -1 for none.
            xyz, rows: (k, 3) positions of the features ``rows``.

        Returns:
            Inlier mask of the features (k,) bool, number of map point inliers, number of map points matched.
        """
        m, frame = self.map, tracked.frame
        _, candidates = local_map(m, seen, self.config.local_map_keyframes)
        frame.point[:], frame.area[:] = -1, 0.0
        features = Sighted(xyz, tracked.xy[rows], tracked.inv_sigma2[rows])
        self.rules.gate.refine(m, frame, features)
        self.rules.search.seek(m, frame, candidates, True)
        matches = int((frame.point >= 0).sum())
        points, agree = self.rules.gate.refine(m, frame, features)
        return agree, points, matches

    def set_reference(self, frame: Frame, reference: Frame) -> None:
        """Set the reference: the keyframe with most common points, or the predecessor's."""
        m = self.map
        keyframes, _ = local_map(m, frame.point, 1)
        frame.reference_keyframe = (
            int(keyframes[0]) if len(keyframes) else m.live(reference.reference_keyframe)
        )

    def pass_tracks_on(self, tracked: TrackedFrame, reference: TrackedFrame, pairs: np.ndarray) -> None:
        """Pass first view and position of each feature to its match, triangulated where possible."""
        theirs, own = pairs.T
        view, T = self.map.view, tracked.frame.T_cam_map
        tracked.follow(own, reference, theirs)
        tracked.set_positions(own, reference.positions(theirs, self.pose_of(reference.frame)), T)
        poses = np.empty((len(self._placed), 4, 4))
        for number in np.unique(tracked.seen_from[own]):
            poses[number] = self.pose_of(self._placed[number])
        xyz, disagrees = triangulate_pairs(
            poses[tracked.seen_from[own]],
            rays(tracked.seen_at[own], view),
            np.ascontiguousarray(T),
            rays(tracked.xy[own], view),
            CHI2_2DOF / (tracked.inv_sigma2[own] * view.fx * view.fy),
            float(np.cos(np.deg2rad(self._thread_config.min_parallax_deg))),
        )
        seen = np.isfinite(xyz[:, 0])
        tracked.set_positions(own[seen], xyz[seen], T)
        tracked.forget(own[disagrees])

    def register(self, tracked: TrackedFrame) -> None:
        """Register a placed frame; its new features take their depth from nearby map points."""
        frame, m = tracked.frame, self.map
        new = np.flatnonzero(tracked.seen_from < 0)
        tracked.seen_from[new] = len(self._placed)
        tracked.track[new] = self._tracks + np.arange(len(new))
        self._tracks += len(new)
        self._placed.append(frame)
        rows = np.flatnonzero(frame.point >= 0)
        take_depth_from_points(
            tracked,
            m.arrays.pt_xyz[frame.point[rows]],
            frame.features.xy[rows],
            frame.T_cam_map,
            m.view,
            self._radius_px,
        )
        self.latest = tracked

    def pose_of(self, frame: Frame) -> np.ndarray:
        """(4, 4) T_cam_map of a placed frame in the current map."""
        return frame.T_cam_reference @ self.map.T_cam_map(frame.reference_keyframe)
