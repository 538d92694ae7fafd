"""Error of the relative pose of two lead-in frames against their baseline, from their matches alone.

The measurement is independent of the SLAM. No pose is rejected for its small parallax, as those are the
subject.

Source: Huang et al., Dual-SLAM, 2020, Sec. II and Fig. 2: narrow-baseline pose estimation is ill-conditioned.
"""

from functools import cache
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


def judge_pairs(sequence: Sequence, frames: int, seed: int) -> dict[str, Any]:
    """The columns ``pairs{gap}_…`` of a record: medians over the pairs of each gap.

    A pair counts if a pose is found and the camera moved between the two. Matches are counted right or wrong;
    the direction of the translation may be off by up to 180 degrees.

    Args:
        sequence: images and true poses.
        frames: length of the lead-in; later frames are not used.
        seed: of the robust estimation.
    """
    camera = slam_camera(sequence.camera)
    extractor = OrbExtractor(camera.width_px, camera.height_px, default_config(camera).orb)
    features = cache(lambda frame: extractor.extract(sequence.frames[frame]))
    row: dict[str, Any] = {}
    for gap, starts in first_frames(frames).items():
        found = []
        for first, second in ((start, start + gap) for start in starts):
            T_second_first = _true_motion(sequence, first, second)
            if T_second_first is None:
                continue
            a, b = features(first), features(second)
            matches = match_brute_force(a.descriptors, b.descriptors, _MAX_DISTANCE, _RATIO)
            sampling = int(rng_for(seed, "pairs", first, second).integers(2**31))
            pose = relative_pose(a.xy[matches[:, 0]], b.xy[matches[:, 1]], camera, sampling)
            if pose is not None:
                found.append((len(matches), *_errors(*pose, T_second_first)))
        row[pair_column(gap, "count")] = len(found)
        medians = np.median(found, axis=0).tolist() if found else [None] * 4
        for name, median in zip(
            ("matches", "baseline_m", "rotation_deg", "direction_deg"), medians, strict=True
        ):
            row[pair_column(gap, name)] = median
    return row


def _true_motion(sequence: Sequence, first: int, second: int) -> np.ndarray | None:
    """(4, 4) motion from one frame to another; None if it is not known or the camera did not move."""
    truth = sequence.T_world_cam
    if truth is None:
        return None
    T_second_first = np.linalg.inv(truth[second]) @ truth[first]
    moved = np.linalg.norm(T_second_first[:3, 3]) > _LEAST_BASELINE_M  # not if the truth is NaN
    return T_second_first if moved else None


def _errors(R: np.ndarray, direction: np.ndarray, T_second_first: np.ndarray) -> tuple[float, float, float]:
    """Length of the baseline, errors of rotation and of direction in degrees."""
    baseline = T_second_first[:3, 3]
    rotation_deg = float(rotation_angle_deg((R.T @ T_second_first[:3, :3])[None])[0])
    return float(np.linalg.norm(baseline)), rotation_deg, angle_deg(direction, baseline)


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
    E, inliers = cv2.findEssentialMat(
        pixels_1, pixels_2, K, K, undistorted, undistorted, magsac(seed, _THRESHOLD_PX)
    )
    if E is None or E.shape != (3, 3) or not np.isfinite(E).all():
        return None
    _, R, t, *_ = cv2.recoverPose(E, pixels_1, pixels_2, K, distanceThresh=_FARTHEST, mask=inliers)
    return R, t[:, 0]


def magsac(seed: int, threshold_px: float) -> cv2.UsacParams:
    """Settings of MAGSAC++ with local optimisation, one thread, for :func:`cv2.findEssentialMat`."""
    params = cv2.UsacParams()
    params.confidence = _CONFIDENCE
    params.threshold = threshold_px
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
