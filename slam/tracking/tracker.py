"""Tracking: estimate the pose of every frame from its matches with the map."""

from copy import copy
from dataclasses import dataclass

import numpy as np

from dslab.slam.core.frame import Frame, FrameFeatures, twist_between
from dslab.slam.core.timing import StageTimer
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.map import Map
from dslab.slam.optimization.pose import direction_deviation
from dslab.slam.tracking.belief import MotionBelief
from dslab.slam.tracking.config import TrackingConfig
from dslab.slam.tracking.doubt import Doubt
from dslab.slam.tracking.local_map import local_map
from dslab.slam.tracking.rules.interface import Rules
from dslab.slam.tracking.rules.registry import rules_of

_TELLING = 100  # points whose median motion is that of all


@dataclass(frozen=True)
class TrackingOutcome:
    """Outcome of tracking a frame: success, counts and reason of failure."""

    success: bool
    inliers: int
    matches: int
    reason: str = ""


class Tracker:
    """Tracks frames in one map, forward or backward in time.

    Attributes:
        observing: count in the map how often its points are seen; else tracking leaves the map unchanged.
        last: the last tracked frame.
        velocity: T_cam_last of the last step, None where unknown.
        twist: (6,) how the scene moves past the camera, see ``twist_between``; 0 where unknown.
        motion: how far predicted poses may be off; it goes on with that of the tracker before.
        sharpest: least variance of a pose since the last keyframe, at the usual noise.
        doubt: of the motion since the start.
        passed_over: number of frames without a pose since the last tracked one.
        last_keyframe: the last frame that has become a keyframe, or will.
        resumed: the frame from which tracking went on after a relocalization.
    """

    def __init__(
        self, map_: Map, config: TrackingConfig, timer: StageTimer, motion: MotionBelief | None = None
    ) -> None:
        self.map = map_
        self.config = config
        self.timer = timer
        self.observing = True
        self.last: Frame | None = None
        self.velocity: np.ndarray | None = None
        self.twist = np.zeros(6)
        self.motion = MotionBelief() if motion is None else copy(motion)
        self.sharpest = np.inf
        self.doubt = Doubt(config.doubt)
        self._in_motion = False  # the velocity is that of a tracked step
        self.last_keyframe: FrameFeatures | None = None
        self.resumed: FrameFeatures | None = None
        self.passed_over = 0

    @property
    def rules(self) -> Rules:
        """What it decides by."""
        return rules_of(self.config)

    def start(self, frame: Frame, keyframe: int, velocity: np.ndarray | None = None) -> None:
        """Start from a frame with known pose and matches."""
        self.last = frame
        self.velocity = velocity
        self.keyframe_made(frame, keyframe)

    def keyframe_requested(self, frame: Frame) -> None:
        """Start the least interval to the next keyframe at ``frame``, which will become one."""
        self.last_keyframe = frame.features
        self.sharpest = np.inf

    def resume(self, frame: Frame) -> None:
        """Continue from a relocalized frame, with zero velocity."""
        self.last, self.velocity, self._in_motion = frame, np.eye(4), False
        self.twist = np.zeros(6)
        self.passed_over = 0
        self.last_keyframe = self.resumed = frame.features

    def corrected(self, factor: np.ndarray) -> None:
        """Follow a map whose lengths have changed by ``factor`` (n_keyframes,) around each keyframe."""
        if self.last is None:
            return
        own = factor[self.last.reference_keyframe]
        self.last.T_cam_reference = self.last.T_cam_reference.copy()
        self.last.T_cam_reference[:3, 3] *= own
        self.last.covariance = self.last.covariance.copy()
        self.last.covariance[:3] *= own
        self.last.covariance[:, :3] *= own
        if self.velocity is not None:
            self.velocity = self.velocity.copy()
            self.velocity[:3, 3] *= own
        self._refreshed_last()
        self.doubt.tie_scale()

    def keyframe_made(self, frame: Frame, keyframe: int) -> None:
        """Take over that ``frame`` has become ``keyframe``, with the points that mapping created in it."""
        frame.point[:] = self.map.observed_points(keyframe)
        frame.reference_keyframe = keyframe
        frame.T_cam_reference = np.eye(4)
        frame.T_cam_map = self.map.T_cam_map(keyframe)
        self.last_keyframe = frame.features
        self.sharpest = np.inf

    def rebase(self, map_: Map, last: Frame) -> None:
        """Continue in a map that has absorbed this tracker's; ``last`` is already expressed in it."""
        self.map = map_
        self.last = last
        last.T_cam_map = last.T_cam_reference @ map_.T_cam_map(last.reference_keyframe)

    def track(self, frame: Frame) -> TrackingOutcome:
        """Estimate the pose of the next frame and match it with the local map.

        Args:
            frame: features only; pose, matches and reference keyframe are filled in.
        """
        last = self._refreshed_last()
        with self.timer("predict"):
            found = self.rules.search.predict(self, frame, last)
        if not found:
            return TrackingOutcome(False, 0, int((frame.point >= 0).sum()), "too_few_matches_with_last_frame")
        if not self.passed_over and np.isfinite(frame.depth):
            frame.features = frame.features.moving(twist_between(last, frame, frame.depth))
        with self.timer("local_map"):
            inliers, matches = self._track_local_map(frame)
        fault = self.rules.loss.fault(self, frame, last, inliers)
        if fault:
            return TrackingOutcome(False, inliers, matches, fault)
        self._accept(frame, last)
        return TrackingOutcome(True, inliers, matches)

    def pass_over(self, frame: Frame) -> None:
        """Skip an unusable frame: the last pose is carried on by the motion model.

        It is a copy that is carried: the last tracked frame keeps the pose that was estimated for it.
        """
        last = self.last = copy(self._refreshed_last())
        self.passed_over += 1
        if self.velocity is not None:
            last.T_cam_map = self.velocity @ last.T_cam_map
            last.T_cam_reference = last.T_cam_map @ np.linalg.inv(self.map.T_cam_map(last.reference_keyframe))

    def take_pose(
        self, frame: Frame, T_cam_map: np.ndarray, keyframe: int, velocity: np.ndarray
    ) -> TrackingOutcome:
        """Go on from a frame whose pose was found otherwise; its features are matched as far as they fit.

        Args:
            frame: features only, which :meth:`track` could not place.
            T_cam_map: (4, 4) its pose, refined by its matches if they would do for tracking.
            keyframe: that it shares its view with.
            velocity: (4, 4) from here on.
        """
        m, rules = self.map, self.rules
        frame.T_cam_map, frame.reference_keyframe = T_cam_map.copy(), keyframe
        frame.point[:] = -1
        _, candidates = local_map(m, m.observed_points(keyframe), self.config.local_map_keyframes)
        depth = kernels.median_depth(m.arrays, keyframe)
        frame.covariance = self.motion.predicted(np.zeros((6, 6)), 1, depth)
        rules.search.seek(m, frame, candidates, False)
        matches = int((frame.point >= 0).sum())
        inliers, _ = rules.gate.refine(m, frame)
        frame.relative = rules.gate.relative(m, frame)
        if rules.loss.fault(self, frame, frame, inliers):
            frame.T_cam_map, frame.relative = T_cam_map, None
        if not inliers:
            frame.point[:] = -1
        frame.T_cam_reference = frame.T_cam_map @ np.linalg.inv(m.T_cam_map(keyframe))
        self.last, self.velocity, self._in_motion = frame, velocity, False
        return TrackingOutcome(True, inliers, matches)

    def wants_keyframe(self, frame: Frame, inliers: int, mapping_is_idle: bool = True) -> bool:
        """Return True if a tracked frame is to become a keyframe."""
        return self.rules.keyframe.wants(self, frame, inliers, mapping_is_idle)

    # -- steps -------------------------------------------------------------------------------------------

    def _refreshed_last(self) -> Frame:
        """The last frame, moved along with its reference keyframe and freed of dropped points."""
        last = self.last
        if last is None:
            raise RuntimeError("the tracker has not been started")
        last.T_cam_map = last.T_cam_reference @ self.map.T_cam_map(last.reference_keyframe)
        kernels.resolve_points(self.map.arrays, last.point)
        return last

    def _track_local_map(self, frame: Frame) -> tuple[int, int]:
        """Match the frame with its local map; (inliers, matches)."""
        m, rules = self.map, self.rules
        keyframes, points = local_map(m, frame.point, self.config.local_map_keyframes)
        if not len(keyframes):
            return 0, 0
        rules.search.seek(m, frame, points, self.observing)
        matches = int((frame.point >= 0).sum())
        inliers, _ = rules.gate.refine(m, frame)
        frame.reference_keyframe = int(keyframes[0])
        frame.relative = rules.gate.relative(m, frame)
        return inliers, matches

    def _accept(self, frame: Frame, last: Frame) -> None:
        if self.observing:
            self.map.arrays.pt_found[frame.point[frame.point >= 0]] += 1
        frame.T_cam_reference = frame.T_cam_map @ np.linalg.inv(self.map.T_cam_map(frame.reference_keyframe))
        if not self.passed_over:
            self.rules.search.learn(self, frame, last)
            self._note_motion(frame, last)
            if np.isfinite(frame.depth):
                self.twist = twist_between(last, frame, frame.depth)
            self.velocity = frame.T_cam_map @ np.linalg.inv(last.T_cam_map)
            self._in_motion = True
        self.passed_over = 0
        self.last = frame

    def _note_motion(self, frame: Frame, last: Frame) -> None:
        m, matched = self.map, frame.point >= 0
        points = frame.point[matched]
        if self.velocity is None or not self._in_motion or not len(points):
            return
        variance = np.trace(frame.covariance[3:, 3:])
        if not variance > 0:  # the gate has not told it
            xyz, information = m.arrays.pt_xyz[points], m.view.inv_sigma2[frame.features.octave[matched]]
            variance = direction_deviation(frame.T_cam_map, xyz, information, m.view.fx, m.view.fy) ** 2
        points = points[:: max(len(points) // _TELLING, 1)]
        made = m.features(int(np.sort(m.arrays.pt_first_keyframe[points])[len(points) // 2]))
        predicted, xyz = self.velocity @ last.T_cam_map, m.arrays.pt_xyz[points]
        self.doubt.note(frame, last, predicted, xyz, made.stamp_s, float(np.sqrt(variance)))
