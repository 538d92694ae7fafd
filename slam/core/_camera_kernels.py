"""Residual distortion and rolling shutter, keypoint by keypoint."""

import numpy as np
from numba import njit

_ITERATIONS = 8
_CLOSE = 1e-7  # focal lengths


@njit(cache=True, nogil=True)
def undistort_residual(xy, residual, intrinsics):
    """Take a residual distortion out of pixels (N, 2) float64 by fixed-point iteration.

    ``residual`` (4,), ``intrinsics`` (4,); see the camera. Returns (N, 2) float64.
    """
    k1, k2, p1, p2 = residual[0], residual[1], residual[2], residual[3]
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    ideal = np.empty((len(xy), 2))
    for i in range(len(xy)):
        u, v = (xy[i, 0] - cx) / fx, (xy[i, 1] - cy) / fy
        x, y = u, v
        for _ in range(_ITERATIONS):
            xx, yy, xy_ = x * x, y * y, 2.0 * x * y
            r2 = xx + yy
            stretch = 1.0 + r2 * (k1 + r2 * k2)
            before_x, before_y = x, y
            x = (u - (xy_ * p1 + (r2 + 2.0 * xx) * p2)) / stretch
            y = (v - (xy_ * p2 + (r2 + 2.0 * yy) * p1)) / stretch
            if abs(x - before_x) + abs(y - before_y) < _CLOSE:
                break
        ideal[i, 0], ideal[i, 1] = x * fx + cx, y * fy + cy
    return ideal


@njit(cache=True, nogil=True)
def row_shifts(rows, xy, twist, intrinsics, height):
    """Shift (N, 2) of pixels ``xy`` (N, 2) per second of read-out time, px/s; ``rows`` (N,) of the image."""
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    a, b, c, p, q, r = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
    shifts = np.empty((len(xy), 2))
    for i in range(len(xy)):
        x, y = (xy[i, 0] - cx) / fx, (xy[i, 1] - cy) / fy
        since = (rows[i] + 0.5) / height - 0.5
        shifts[i, 0] = since * fx * (a - x * c + q * (1.0 + x * x) - r * y - p * x * y)
        shifts[i, 1] = since * fy * (b - y * c + q * x * y + r * x - p * (1.0 + y * y))
    return shifts
