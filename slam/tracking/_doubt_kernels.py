"""Angles under which a change of pose moves points."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def median_angles(points, T_cam_map, T_other_map):
    """Median angles, rad: by the translation of a change of pose alone, and by all of it."""
    n = points.shape[0]
    alone, seen = np.empty(n), np.empty(n)
    now, before, turned = np.empty(3), np.empty(3), np.empty(3)
    R = np.zeros((3, 3))
    for r in range(3):
        for c in range(3):
            for k in range(3):
                R[r, c] += T_cam_map[r, k] * T_other_map[c, k]
    for i in range(n):
        for r in range(3):
            now[r], before[r] = T_cam_map[r, 3], T_other_map[r, 3]
            for c in range(3):
                now[r] += T_cam_map[r, c] * points[i, c]
                before[r] += T_other_map[r, c] * points[i, c]
        for r in range(3):
            turned[r] = R[r, 0] * before[0] + R[r, 1] * before[1] + R[r, 2] * before[2]
        alone[i], seen[i] = _angle(now, turned), _angle(now, before)
    return np.median(alone), np.median(seen)


@njit(cache=True, nogil=True)
def _angle(a, b):
    """Angle between two vectors, to second order, rad; 0 if one of them has no length."""
    aa = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
    bb = b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
    ab = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return np.sqrt(max(0.0, 2.0 - 2.0 * ab / np.sqrt(aa * bb))) if aa * bb > 0.0 else 0.0
