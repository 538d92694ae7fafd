"""Third recovery thread: grid-based motion statistics (GMS) matches and EPnP, backward.

The paper has two threads. This one stands between them: it asks for no prediction, as SIFT's does not, and
needs no images, as ORB's does not. Source: Bian et al., "GMS", 2017; Lepetit, Moreno-Noguer, Fua, "EPnP",
2009.
"""

from dslab.slam.core.frame import Frame
from dslab.slam.core.settings import setting, settings
from dslab.slam.core.timing import StageTimer
from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryCost, RecoveryResult, RecoveryTask
from dslab.slam.dual.recovery.propagation import propagate
from dslab.slam.mapping.local_mapping import LocalMapper
from dslab.slam.matching.gms import GmsConfig, match_gms
from dslab.slam.tracking.pnp import ransac_pnp
from dslab.slam.tracking.tracker import Tracker, TrackingOutcome


@settings
class GmsRecoveryConfig(RecoveryConfig):
    """Settings of the GMS thread."""

    threshold_factor: float = setting(6.0, "support that a match needs from its neighbourhood; alpha of GMS")
    ransac_iterations: int = setting(300, "most samples of the pose RANSAC")
    ransac_error_px: float = setting(4.0, "largest error of an inlier of the pose RANSAC")
    min_pose_inliers: int = setting(10, "fewest matches that are inliers of the pose")
    min_inliers: int = setting(20, "fewest inliers after local map matching")


class GmsRecovery:
    """Recovery that places frames by GMS matches with a keyframe."""

    name = "gms"
    needs_images = False
    # Measured: CPU on one core, 640x480, 1,000 features.
    cost = RecoveryCost(frame_ms=5.0, keyframe_ms=17.0, alignment_ms=4.0)

    def __init__(self, config: RecoveryConfig | None = None) -> None:
        self.config = GmsRecoveryConfig.extending(config)

    def run(self, task: RecoveryTask) -> RecoveryResult:
        """Place the buffered frames newest first."""
        mapper = LocalMapper(task.new_map, self.config.mapping_in(task))
        return propagate(task, self.config, GmsTracker(task, self.config), mapper)


class GmsTracker(Tracker):
    """Places frames by GMS matches with the keyframe that the last one shares most points with."""

    def __init__(self, task: RecoveryTask, config: GmsRecoveryConfig) -> None:
        super().__init__(task.new_map, config.tracking_in(task), StageTimer(), task.motion)
        self._gms_config = config
        self._size_px = task.camera.width_px, task.camera.height_px
        self._rng = task.rng
        self.start(task.first, task.first.reference_keyframe)

    def track(self, frame: Frame) -> TrackingOutcome:
        """Place the frame by matches with a keyframe, then match the local map.

        Args:
            frame: features only; pose, matches and reference keyframe are filled in.
        """
        config, m = self._gms_config, self.map
        last = self._refreshed_last()
        keyframe = m.live(last.reference_keyframe)
        points = m.observed_points(keyframe)
        pairs = match_gms(
            m.features(keyframe), frame.features, self._size_px, GmsConfig(config.threshold_factor)
        )
        pairs = pairs[points[pairs[:, 0]] >= 0]
        if len(pairs) < config.min_pose_inliers:
            return TrackingOutcome(False, 0, len(pairs), "too_few_gms_matches")
        rows, seen = pairs[:, 1], points[pairs[:, 0]]
        found = ransac_pnp(
            m.arrays.pt_xyz[seen], frame.features.xy[rows], m.view, self._rng,
            config.ransac_iterations, config.ransac_error_px, config.min_pose_inliers,
        )  # fmt: skip
        if found is None:
            return TrackingOutcome(False, 0, len(pairs), "no_pose_from_gms_matches")
        frame.T_cam_map, agree = found
        frame.point[rows[agree]] = seen[agree]
        frame.area[:] = 0.0
        inliers, matches = self.rules.gate.refine(m, frame)[0], len(pairs)
        if inliers >= config.min_pose_inliers:
            inliers, matches = self._track_local_map(frame)
        if inliers < max(config.min_inliers, self.rules.loss.least_inliers):
            return TrackingOutcome(False, inliers, matches, "too_few_local_map_inliers")
        fault = self.rules.loss.fault_of_view(self, frame, last)
        if fault:
            return TrackingOutcome(False, inliers, matches, fault)
        self._accept(frame, last)
        return TrackingOutcome(True, inliers, matches)
