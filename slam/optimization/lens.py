"""Self-calibration: what a calibration has left of lens and shutter, from a map's own observations.

A camera's images are undistorted with the calibration that came with them. What it leaves shows in a map: the
same points move from the middle of the image, where they are first seen, to its edge. A rolling shutter reads
the rows of an image one after the other: while the camera turns, they are not of one pose.
"""

from dataclasses import dataclass

import numpy as np

from dslab.slam.optimization import _ba_kernels, _lens_kernels
from dslab.slam.optimization._se3 import orthonormalise
from dslab.slam.optimization.pose import CHI2_2DOF

Coefficients = tuple[float, float, float, float]


@dataclass(frozen=True)
class LensEstimate:
    """Estimate of the residual distortion and of the shutter, with the map adjusted to it.

    Attributes:
        residual: (k1, k2, p1, p2), see :class:`slam.core.camera.PinholeCamera`.
        readout_s: time in which the rows of an image are read.
        T_cam_map: (C, 4, 4) poses; fixed ones are the input's.
        points: (P, 3).
        significance: squared change of all coefficients, in units of its covariance over the points: errors
            of one point's observations may depend on each other in any way. Chi-square with 4 degrees of
            freedom by chance, with 5 if there are ``row_shifts``.
        readout_significance: likewise of the read-out time alone, against a global shutter; 1 degree.
    """

    residual: Coefficients
    readout_s: float
    T_cam_map: np.ndarray
    points: np.ndarray
    significance: float
    readout_significance: float


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
    readout_s: float = 0.0,
    row_shifts: np.ndarray | None = None,
    iterations: int = 12,
    usual_shift_px: float = np.inf,
    usual_readout_s: float = 0.02,
) -> LensEstimate:
    """Bundle-adjust poses, points, the four coefficients of the residual distortion and the read-out time.

    Args:
        T_cam_map: (C, 4, 4) poses.
        fixed: (C,) bool, cameras that fix the gauge; at least one.
        points: (P, 3) frame map.
        obs_cam: (M,) camera of each observation.
        obs_point: (M,) point of each observation.
        pixels: (M, 2) keypoints, px, residual distortion and shift of their rows included.
        inv_sigma2: (M,) information of each keypoint, 1/px².
        intrinsics: (4,) fx, fy, cx, cy, px.
        residual: the coefficients so far.
        readout_s: the read-out time so far.
        row_shifts: (M, 2) shift of each observation per second of read-out time, px/s; None for a global
            shutter, ``readout_s`` is then 0.
        iterations: most steps tried.
        usual_shift_px: root mean square shift of the keypoints by which calibrations are usually off. Where
            the observations say little, the estimate keeps to it. It does not enter the significance.
        usual_readout_s: likewise of the read-out time.

    Source: Triggs et al., "Bundle Adjustment: A Modern Synthesis", 1999 (self-calibration as further
        parameters of the adjustment, and their prior); Liang and Zeger, 1986 (covariance of dependent
        observations).
    """
    K = np.asarray(intrinsics, np.float64)
    start, order = _ba_kernels.sort_by_point(len(points), np.ascontiguousarray(obs_point, np.int32))
    camera = np.ascontiguousarray(obs_cam, np.int32)[order]
    T, xyz = T_cam_map.astype(np.float64), points.astype(np.float64)
    before = np.array([*residual, readout_s if row_shifts is not None else 0.0])
    slot = np.where(fixed, -1, np.cumsum(~fixed) - 1)
    weights = np.ascontiguousarray(inv_sigma2[order], np.float64)
    seen = np.ascontiguousarray(pixels[order], np.float64)
    drift = np.zeros_like(seen) if row_shifts is None else np.ascontiguousarray(row_shifts[order], float)
    free = int((slot >= 0).sum())
    prior, k = np.zeros((5, 5)), before.copy()
    prior[:4, :4] = _shift_of(seen, K) / usual_shift_px**2
    prior[4, 4] = usual_readout_s**-2
    information, spread = _lens_kernels.adjust(
        T, xyz, start, camera, seen, weights, drift, K, k, slot, free, iterations, CHI2_2DOF, prior
    )
    for c in np.flatnonzero(slot >= 0):
        orthonormalise(T[c])
    n = 5 if drift.any() else 4
    change = (k - before)[:n]
    significance = readout_significance = 0.0
    if np.isfinite(k).all() and np.linalg.det(spread[:n, :n]) > 0:
        # What the observations alone ask for: at the estimate they pull against the prior.
        back = (prior @ k)[:n]
        alone = np.linalg.solve(information[:n, :n], back)
        covariance = np.linalg.inv(information[:n, :n]) @ spread[:n, :n] @ np.linalg.inv(information[:n, :n])
        significance = _wald(change + alone, covariance)
        if n == 5:
            readout_significance = float((k[4] + alone[4]) ** 2 / covariance[4, 4])
    return LensEstimate(
        (float(k[0]), float(k[1]), float(k[2]), float(k[3])),
        float(k[4]),
        T,
        xyz,
        significance,
        readout_significance,
    )


def _wald(change: np.ndarray, covariance: np.ndarray) -> float:
    return float(change @ np.linalg.solve(covariance, change))


def _shift_of(pixels: np.ndarray, K: np.ndarray) -> np.ndarray:
    """(4, 4) form that gives the mean square shift of keypoints (M, 2) by the coefficients, px²."""
    x, y = ((pixels - K[2:]) / K[:2]).T
    r2 = x * x + y * y
    u = K[0] * np.column_stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x])
    v = K[1] * np.column_stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y])
    return (u.T @ u + v.T @ v) / max(len(pixels), 1)
