"""Recovery thread 2: SIFT matches and PnP, backward. Source: paper, Algorithm 1, lines 15-25.

It has no motion model: a frame gets its pose from SIFT matches alone, however far the camera has moved since
the last placed frame, as long as the views overlap. The map grows with ORB features on these poses.
"""

import numpy as np

from dslab.slam.core.frame import Frame
from dslab.slam.core.settings import setting, settings
from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryCost, RecoveryResult, RecoveryTask
from dslab.slam.dual.recovery.propagation import propagate
from dslab.slam.dual.recovery.tracks import TrackRecoveryConfig, TrackTracker
from dslab.slam.features.sift import SiftFrame, match, sift_frame
from dslab.slam.features.sift_detector import SiftDetector
from dslab.slam.tracking.pnp import ransac_pnp
from dslab.slam.tracking.tracker import TrackingOutcome


@settings
class SiftRecoveryConfig(TrackRecoveryConfig):
    """Settings of the SIFT thread."""

    n_features: int = setting(1000, "most SIFT keypoints per frame, strongest first")
    contrast: float = setting(0.005, "least contrast of a keypoint; OpenCV's usual value is .04")
    octaves: int = setting(4, "most octaves in which keypoints are sought", ge=1)
    most_pixels: int = setting(500_000, "a larger image is reduced to this size", unit="pixels")
    ratio: float = setting(0.8, "best over second best descriptor distance of a SIFT match", le=1)
    ransac_iterations: int = setting(300, "most samples of the pose RANSAC")
    ransac_error_px: float = setting(3.0, "largest error of an inlier of the pose RANSAC")


class SiftRecovery:
    """Recovery that places frames by SIFT features and maps ORB features."""

    name = "sift"
    needs_images = True
    # Measured: CPU on one core, 640x480, 1,000 ORB features; the start reckoned as three frames.
    cost = RecoveryCost(frame_ms=20.0, keyframe_ms=50.0, alignment_ms=4.0, start_ms=60.0)

    def __init__(self, config: RecoveryConfig | None = None) -> None:
        self.config = SiftRecoveryConfig.extending(config)

    def run(self, task: RecoveryTask) -> RecoveryResult:
        """Place the buffered frames newest first, each by SIFT matches with the last one."""
        tracker = SiftTracker(task, self.config)
        return propagate(task, self.config, tracker, tracker.mapper(task))


def detector(config: SiftRecoveryConfig) -> SiftDetector:
    """Detector of the thread."""
    return SiftDetector(config.n_features, config.contrast, config.octaves, config.most_pixels)


class SiftTracker(TrackTracker):
    """Places frames by SIFT matches and PnP."""

    latest: SiftFrame
    keyframe_view: SiftFrame

    def __init__(self, task: RecoveryTask, config: SiftRecoveryConfig) -> None:
        self._sift_config = config
        self._task = task
        self._detector = detector(config)
        super().__init__(task, config, self._detect(task.first))

    def track(self, frame: Frame) -> TrackingOutcome:
        """Place the frame by SIFT matches with the last placed frame.

        Args:
            frame: features only; pose, matches and reference keyframe are filled in.
        """
        return self._place(self._detect(frame), self.latest)

    def _detect(self, frame: Frame) -> SiftFrame:
        config = self._sift_config
        kind = ("sift", config.n_features, config.contrast, config.octaves, config.most_pixels)
        found = self._task.found_in(frame.features.index, self._detector.detect, kind)
        return sift_frame(found, frame, self._task.camera)

    def _place(self, sift: SiftFrame, reference: SiftFrame) -> TrackingOutcome:
        config = self._sift_config
        pairs = match(reference, sift, config.ratio)
        placed = pairs[reference.known[pairs[:, 0]]]
        if len(placed) < config.min_features:
            return TrackingOutcome(False, 0, len(placed), "too_few_sift_matches")
        xyz = reference.positions(placed[:, 0], self.pose_of(reference.frame))
        found = ransac_pnp(
            xyz, sift.xy[placed[:, 1]], self.map.view, self._task.rng,
            config.ransac_iterations, config.ransac_error_px, config.min_features,
        )  # fmt: skip
        if found is None:
            return TrackingOutcome(False, 0, len(placed), "no_pose_from_sift_matches")
        sift.frame.T_cam_map, _ = found
        outcome, agree = self.confirm(sift, reference, xyz, placed[:, 1])
        if outcome.success:
            wrong = np.zeros(len(sift.xy), np.bool_)
            wrong[placed[~agree, 1]] = True
            self.pass_tracks_on(sift, reference, pairs[~wrong[pairs[:, 1]]])
            self.register(sift)
        return outcome
