"""Error of the relative pose of two lead-in frames against their baseline, from their matches alone.

The measurement is independent of the SLAM. No pose is rejected for its small parallax, as those are the
subject.

Source: Huang et al., Dual-SLAM, 2020, Sec. II and Fig. 2: narrow-baseline pose estimation is ill-conditioned.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from dslab.experiments.eq1.records import PAIR_GAPS, PAIRS_PER_GAP, pair_column
from dslab.experiments.evaluation.alignment import rotation_angle_deg
from dslab.experiments.runs.execution import slam_camera
from dslab.scenarios.seeds import rng_for
from dslab.sim.sequence import Sequence
from dslab.slam.config import default_config
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import Features
from dslab.slam.features.orb import OrbExtractor
from dslab.slam.matching.brute_force import match_brute_force

_MAX_DISTANCE, _RATIO = 50, 0.8
_THRESHOLD_PX = 1.0
_CONFIDENCE, _ITERATIONS = 0.999, 2000
# Five matches are fitted exactly, whether right or wrong.
_LEAST_MATCHES = 8
_LEAST_BASELINE_M = 1e-6
# In baselines. OpenCV's default of 50 excludes most points of a narrow pair from the choice among four poses.
_FARTHEST = 1e6


@dataclass(frozen=True)
class PairError:
    """Error of the relative pose of two frames.

    Attributes:
        matches: number of feature matches, right or wrong.
        baseline_m: true distance of the two cameras.
        rotation_deg: angle of the rotation between estimate and truth.
        direction_deg: angle between the estimated and the true direction of translation, up to 180.
    """

    matches: int
    baseline_m: float
    rotation_deg: float
    direction_deg: float


class FramePairs:
    """Pairs of frames of a sequence, with the features that the tracker would extract.

    Args:
        sequence: images and true poses.
        seed: of the robust estimation.
    """

    def __init__(self, sequence: Sequence, seed: int) -> None:
        self._sequence, self._seed = sequence, seed
        self._camera = slam_camera(sequence.camera)
        width_px, height_px = self._camera.width_px, self._camera.height_px
        self._extractor = OrbExtractor(width_px, height_px, default_config(self._camera).orb)
        self._features: dict[int, Features] = {}

    def error(self, first: int, second: int) -> PairError | None:
        """The error of one pair; None without a pose, or if the camera did not move between the two.

        Args:
            first, second: indices of the frames.
        """
        truth = self._sequence.T_world_cam
        if truth is None:
            return None
        T_second_first = np.linalg.inv(truth[second]) @ truth[first]
        baseline_m = float(np.linalg.norm(T_second_first[:3, 3]))
        if not baseline_m > _LEAST_BASELINE_M:  # NaN if the truth is unknown
            return None
        a, b = self._seen(first), self._seen(second)
        matches = match_brute_force(a.descriptors, b.descriptors, _MAX_DISTANCE, _RATIO)
        seed = int(rng_for(self._seed, "pairs", first, second).integers(2**31))
        pose = relative_pose(a.xy[matches[:, 0]], b.xy[matches[:, 1]], self._camera, seed)
        if pose is None:
            return None
        R, direction = pose
        return PairError(
            len(matches),
            baseline_m,
            float(rotation_angle_deg((R.T @ T_second_first[:3, :3])[None])[0]),
            angle_deg(direction, T_second_first[:3, 3]),
        )

    def _seen(self, frame: int) -> Features:
        if frame not in self._features:
            self._features[frame] = self._extractor.extract(self._sequence.frames[frame])
        return self._features[frame]


def judge_pairs(sequence: Sequence, frames: int, seed: int) -> dict[str, Any]:
    """The columns ``pairs{gap}_…`` of a record: medians over the pairs of each gap.

    Args:
        sequence: images and true poses.
        frames: length of the lead-in; later frames are not used.
        seed: of the robust estimation.
    """
    pairs = FramePairs(sequence, seed)
    row: dict[str, Any] = {}
    for gap, starts in first_frames(frames).items():
        found = [e for e in (pairs.error(start, start + gap) for start in starts) if e is not None]
        row[pair_column(gap, "count")] = len(found)
        for name in ("matches", "baseline_m", "rotation_deg", "direction_deg"):
            values = [getattr(error, name) for error in found]
            row[pair_column(gap, name)] = float(np.median(values)) if values else None
    return row


def first_frames(frames: int) -> dict[int, list[int]]:
    """First frames of the pairs of each gap, spread over a lead-in of so many frames.

    They are the same for every gap, so that gaps differ only in the second frame. A gap for which the lead-in
    is too short has none.
    """
    fitting = [gap for gap in PAIR_GAPS if gap < frames]
    spread = np.linspace(0, frames - 1 - max(fitting, default=0), PAIRS_PER_GAP)
    starts = [int(start) for start in np.unique(np.rint(spread))]
    return {gap: starts if gap in fitting else [] for gap in PAIR_GAPS}


def relative_pose(
    xy_1: np.ndarray, xy_2: np.ndarray, camera: PinholeCamera, seed: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """Relative pose of two views from an essential matrix, at any parallax.

    Args:
        xy_1, xy_2: (N, 2) float32 pixels of matches, distorted.
        camera: of both.
        seed: of the sampling.

    Returns:
        (3, 3) rotation and (3,) unit translation, view 1 to view 2; None with fewer than eight matches, or
        if no essential matrix is found.

    Source: Barath, Noskova, Ivashechkin, Matas, "MAGSAC++", CVPR 2020, as in OpenCV.
    """
    if len(xy_1) < _LEAST_MATCHES:
        return None
    pixels_1, pixels_2 = (camera.undistort_points(xy).astype(np.float64) for xy in (xy_1, xy_2))
    K, undistorted = camera.K, np.zeros(5)
    E, inliers = cv2.findEssentialMat(pixels_1, pixels_2, K, K, undistorted, undistorted, _sampling(seed))
    if E is None or E.shape != (3, 3) or not np.isfinite(E).all():
        return None
    _, R, t, *_ = cv2.recoverPose(E, pixels_1, pixels_2, K, distanceThresh=_FARTHEST, mask=inliers)
    return R, t[:, 0]


def _sampling(seed: int) -> cv2.UsacParams:
    params = cv2.UsacParams()
    params.confidence = _CONFIDENCE
    params.threshold = _THRESHOLD_PX
    params.maxIterations = _ITERATIONS
    params.isParallel = False
    params.randomGeneratorState = seed
    params.score = cv2.SCORE_METHOD_MAGSAC
    params.loMethod = cv2.LOCAL_OPTIM_SIGMA
    params.loIterations = 10
    return params


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two non-zero vectors (3,)."""
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
