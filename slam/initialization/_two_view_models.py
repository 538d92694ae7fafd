"""Two-view models: estimation by RANSAC, scores, and decomposition into motions."""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from dslab.slam.optimization._triangulation import triangulate

_CHI2_1DOF = 3.841
_CHI2_2DOF = 5.991
_NOWHERE, _FAR, _TRIANGULATED = 0, 1, 2


@dataclass(frozen=True)
class TriedMotion:
    """A hypothesis of the relative pose and the points that it triangulates.

    Attributes:
        T_2_1: (4, 4) camera 1 to camera 2, unit baseline.
        triangulated: (N,) bool, inliers with a point in front of both cameras and a small reprojection error.
        far: (N,) bool, inliers with too little parallax to triangulate.
        points: (N, 3) frame of camera 1, NaN where not triangulated.
        parallax_deg: (N,) angle between the rays, 0 for outliers.
    """

    T_2_1: np.ndarray
    triangulated: np.ndarray
    far: np.ndarray
    points: np.ndarray
    parallax_deg: np.ndarray


def estimate_models(
    pixels_1: np.ndarray,
    pixels_2: np.ndarray,
    K: np.ndarray,
    seed: int,
    threshold_px: float,
    confidence: float,
    iterations: int,
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Estimate homography and essential matrix of two views by RANSAC; None if not found.

    Source: Barath, Noskova, Ivashechkin, Matas, "MAGSAC++", 2020, as OpenCV has it.
    """
    params = cv2.UsacParams()
    params.confidence = confidence
    params.isParallel = False
    params.maxIterations = iterations
    params.randomGeneratorState = seed
    params.sampler = cv2.SAMPLING_UNIFORM
    params.score = cv2.SCORE_METHOD_MAGSAC
    params.loMethod = cv2.LOCAL_OPTIM_SIGMA
    params.loIterations = 10
    params.threshold = threshold_px
    H, _ = cv2.findHomography(pixels_1, pixels_2, params)
    nothing = np.zeros(5)
    E, _ = cv2.findEssentialMat(pixels_1, pixels_2, K, K, nothing, nothing, params)
    return _sound(H), _sound(E)


def _sound(matrix: np.ndarray | None) -> np.ndarray | None:
    if matrix is None or matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        return None
    return matrix


def homography_score(
    H: np.ndarray | None, pixels_1: np.ndarray, pixels_2: np.ndarray, sigma_px: np.ndarray | float
) -> tuple[float, np.ndarray]:
    """Score and inliers (N,) bool of a homography ``H`` (3, 3), by symmetric transfer.

    Source: ORB-SLAM, 2015, equation (3).
    """
    if H is None or abs(np.linalg.det(H)) < 1e-12 * np.linalg.norm(H) ** 3:
        return 0.0, np.zeros(len(pixels_1), np.bool_)
    forward = ((_transfer(H, pixels_1) - pixels_2) ** 2).sum(axis=1)
    backward = ((_transfer(np.linalg.inv(H), pixels_2) - pixels_1) ** 2).sum(axis=1)
    return _score(forward / sigma_px**2, backward / sigma_px**2, _CHI2_2DOF)


def epipolar_score(
    F: np.ndarray | None, pixels_1: np.ndarray, pixels_2: np.ndarray, sigma_px: np.ndarray | float
) -> tuple[float, np.ndarray]:
    """Score of a fundamental matrix ``F`` (3, 3) by epipolar distances in both views; inliers (N,) bool.

    The gain of a match is cut as for a homography, so that the scores are comparable; the test has one degree
    of freedom.

    Source: ORB-SLAM, 2015, equation (3).
    """
    if F is None:
        return 0.0, np.zeros(len(pixels_1), np.bool_)
    h1, h2 = _homogeneous(pixels_1), _homogeneous(pixels_2)
    line_2, line_1 = h1 @ F.T, h2 @ F
    residual2 = (line_2 * h2).sum(axis=1) ** 2
    tiny = np.finfo(float).tiny
    forward = residual2 / np.maximum((line_2[:, :2] ** 2).sum(axis=1), tiny)
    backward = residual2 / np.maximum((line_1[:, :2] ** 2).sum(axis=1), tiny)
    return _score(forward / sigma_px**2, backward / sigma_px**2, _CHI2_1DOF)


def _score(forward: np.ndarray, backward: np.ndarray, threshold: float) -> tuple[float, np.ndarray]:
    with np.errstate(invalid="ignore"):
        good_forward, good_backward = forward <= threshold, backward <= threshold
    score = (_CHI2_2DOF - forward[good_forward]).sum() + (_CHI2_2DOF - backward[good_backward]).sum()
    return float(score), good_forward & good_backward


def _homogeneous(pixels: np.ndarray) -> np.ndarray:
    return np.column_stack([pixels, np.ones(len(pixels))])


def _transfer(H: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    moved = _homogeneous(pixels) @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return moved[:, :2] / moved[:, 2:]


def homography_motions(H: np.ndarray, K: np.ndarray) -> list[np.ndarray]:
    """Decompose a homography into up to four motions T_2_1 (4, 4); none for a pure rotation.

    Source: Malis, Vargas, "Deeper understanding of the homography decomposition", 2007, as OpenCV has it.
    """
    _, rotations, translations, _ = cv2.decomposeHomographyMat(H, K)
    lengths = [np.linalg.norm(t) for t in translations]
    return [
        _motion(R, t.ravel() / length)
        for R, t, length in zip(rotations, translations, lengths, strict=True)
        if length > 1e-9
    ]


def essential_motions(E: np.ndarray) -> list[np.ndarray]:
    """Decompose an essential matrix into its four motions T_2_1 (4, 4)."""
    R_a, R_b, t = cv2.decomposeEssentialMat(E)
    return [_motion(R, sign * t.ravel()) for R in (R_a, R_b) for sign in (1.0, -1.0)]


def _motion(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def try_motion(
    T_2_1: np.ndarray,
    pixels_1: np.ndarray,
    pixels_2: np.ndarray,
    inliers: np.ndarray,
    K: np.ndarray,
    max_error_px: np.ndarray,
    far_deg: float,
) -> TriedMotion:
    """Triangulate the inliers under a motion, except those with a parallax below ``far_deg``."""
    kind, points, parallax_deg = _triangulate_all(
        T_2_1, pixels_1, pixels_2, inliers, K[0, 0], K[1, 1], K[0, 2], K[1, 2], max_error_px**2, far_deg
    )
    return TriedMotion(T_2_1, kind == _TRIANGULATED, kind == _FAR, points, parallax_deg)


@njit(cache=True, nogil=True)
def _triangulate_all(T_2_1, pixels_1, pixels_2, inliers, fx, fy, cx, cy, max_error2, far_deg):
    """Classify each inlier under a motion: triangulated, too far to triangulate, or inconsistent."""
    n = pixels_1.shape[0]
    kind = np.zeros(n, np.int8)
    points = np.full((n, 3), np.nan)
    parallax = np.zeros(n, np.float64)
    origin = np.eye(4)
    R = T_2_1
    for i in range(n):
        if not inliers[i]:
            continue
        x1, y1 = (pixels_1[i, 0] - cx) / fx, (pixels_1[i, 1] - cy) / fy
        x2, y2 = (pixels_2[i, 0] - cx) / fx, (pixels_2[i, 1] - cy) / fy
        # The first ray in camera 2; without parallax it equals the second.
        rx = R[0, 0] * x1 + R[0, 1] * y1 + R[0, 2]
        ry = R[1, 0] * x1 + R[1, 1] * y1 + R[1, 2]
        rz = R[2, 0] * x1 + R[2, 1] * y1 + R[2, 2]
        sx, sy, sz = ry - rz * y2, rz * x2 - rx, rx * y2 - ry * x2
        sine = np.sqrt(sx * sx + sy * sy + sz * sz)
        parallax[i] = np.degrees(np.arctan2(sine, rx * x2 + ry * y2 + rz))
        if parallax[i] < far_deg:
            kind[i] = _FAR
            continue
        px, py, pz = triangulate(origin, T_2_1, x1, y1, x2, y2)
        if not pz > 0.0:
            continue
        qx = R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz + R[0, 3]
        qy = R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz + R[1, 3]
        qz = R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz + R[2, 3]
        error1 = (fx * (px / pz - x1)) ** 2 + (fy * (py / pz - y1)) ** 2
        error2 = (fx * (qx / qz - x2)) ** 2 + (fy * (qy / qz - y2)) ** 2
        if error1 <= max_error2[i] and error2 <= max_error2[i]:
            kind[i] = _TRIANGULATED
            points[i, 0], points[i, 1], points[i, 2] = px, py, pz
    return kind, points, parallax
