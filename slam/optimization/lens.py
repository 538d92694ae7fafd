"""Self-calibration: the distortion that a calibration has left, from a map's own observations.

A camera's images are undistorted with the calibration that came with them. What it leaves shows in a map: the
same points move from the middle of the image, where they are first seen, to its edge.
"""

from dataclasses import dataclass

import numpy as np

from slam.optimization import _ba_kernels, _lens_kernels
from slam.optimization._se3 import orthonormalise
from slam.optimization.pose import CHI2_2DOF

Coefficients = tuple[float, float, float, float]


@dataclass(frozen=True)
class LensEstimate:
    """Estimate of the residual distortion, with the map adjusted to it.

    Attributes:
        residual: (k1, k2, p1, p2), see :class:`slam.core.camera.PinholeCamera`.
        T_cam_map: (C, 4, 4) poses; fixed ones are the input's.
        points: (P, 3).
        significance: squared change of the coefficients, in units of its covariance over the points: errors
            of one point's observations may depend on each other in any way. Chi-square with 4 degrees of
            freedom by chance.
    """

    residual: Coefficients
    T_cam_map: np.ndarray
    points: np.ndarray
    significance: float


def estimate_lens(
    T_cam_map: np.ndarray,
    fixed: np.ndarray,
    points: np.ndarray,
    obs_cam: np.ndarray,
    obs_point: np.ndarray,
    pixels: np.ndarray,
    inv_sigma2: np.ndarray,
    intrinsics: np.ndarray,
    residual: Coefficients = (0.0, 0.0, 0.0, 0.0),
    iterations: int = 12,
    usual_shift_px: float = np.inf,
) -> LensEstimate:
    """Bundle-adjust poses, points and the four coefficients of the residual distortion.

    Args:
        T_cam_map: (C, 4, 4) poses.
        fixed: (C,) bool, cameras that fix the gauge; at least one.
        points: (P, 3) frame map.
        obs_cam: (M,) camera of each observation.
        obs_point: (M,) point of each observation.
        pixels: (M, 2) keypoints, px, residual distortion included.
        inv_sigma2: (M,) information of each keypoint, 1/px².
        intrinsics: (4,) fx, fy, cx, cy, px.
        residual: the coefficients so far.
        iterations: most steps tried.
        usual_shift_px: root mean square shift of the keypoints by which calibrations are usually off; the
            estimate keeps to it where the observations say little. It does not enter the significance.

    Source: Triggs et al., "Bundle Adjustment: A Modern Synthesis", 1999 (self-calibration as further
        parameters of the adjustment, and their prior); Liang and Zeger, 1986 (covariance of dependent
        observations).
    """
    K = np.asarray(intrinsics, np.float64)
    start, order = _ba_kernels.sort_by_point(len(points), np.ascontiguousarray(obs_point, np.int32))
    camera = np.ascontiguousarray(obs_cam, np.int32)[order]
    T, xyz, k = T_cam_map.astype(np.float64), points.astype(np.float64), np.array(residual, np.float64)
    slot = np.where(fixed, -1, np.cumsum(~fixed) - 1)
    weights = np.ascontiguousarray(inv_sigma2[order], np.float64)
    seen = np.ascontiguousarray(pixels[order], np.float64)
    free = int((slot >= 0).sum())
    prior = _shift_of(seen, K) / usual_shift_px**2
    information, spread = _lens_kernels.adjust(
        T, xyz, start, camera, seen, weights, K, k, slot, free, iterations, CHI2_2DOF, prior
    )
    for c in np.flatnonzero(slot >= 0):
        orthonormalise(T[c])
    change = k - np.array(residual)
    significance = 0.0
    if np.isfinite(k).all() and np.linalg.det(spread) > 0:
        # What the observations alone ask for: at the estimate they pull against the prior.
        pull = information @ change + prior @ k
        significance = float(pull @ np.linalg.solve(spread, pull))
    return LensEstimate((float(k[0]), float(k[1]), float(k[2]), float(k[3])), T, xyz, significance)


def _shift_of(pixels: np.ndarray, K: np.ndarray) -> np.ndarray:
    """(4, 4) form that gives the mean square shift of keypoints (M, 2) by the coefficients, px²."""
    x, y = ((pixels - K[2:]) / K[:2]).T
    r2 = x * x + y * y
    u = K[0] * np.column_stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x])
    v = K[1] * np.column_stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y])
    return (u.T @ u + v.T @ v) / max(len(pixels), 1)
