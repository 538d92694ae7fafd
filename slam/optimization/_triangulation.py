"""Two views in kernels: their fundamental matrix, and one point from both."""

import numpy as np
from numba import njit

_ITERATIONS = 4
# Depth in camera 2 over depth in camera 1, below which a point counts as lying beside camera 2.
_MIN_DEPTH_RATIO = 1e-6


@njit(cache=True, nogil=True)
def fundamental(T_1, T_2, view):
    """(3, 3) F with x_2ᵀ F x_1 = 0 for pixels of two views with poses ``T_cam_map``."""
    R = np.ascontiguousarray(T_2[:3, :3]) @ np.ascontiguousarray(T_1[:3, :3].T)
    t = T_2[:3, 3] - R @ np.ascontiguousarray(T_1[:3, 3])
    skew = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])
    K_inv = np.array(
        [[1 / view.fx, 0.0, -view.cx / view.fx], [0.0, 1 / view.fy, -view.cy / view.fy], [0.0, 0.0, 1.0]]
    )
    return K_inv.T.copy() @ (skew @ R) @ K_inv


@njit(cache=True, nogil=True)
def triangulate(T_cam1_map, T_cam2_map, xn1, yn1, xn2, yn2):
    """Triangulate the point with the least squared reprojection error in both normalised images.

    Gauss-Newton on the ray (a, b, 1) in camera 1 and its inverse depth; unlike the linear method (DLT), it is
    well conditioned even for vanishing parallax.

    Args:
        T_cam1_map: (4, 4) pose of camera 1.
        T_cam2_map: (4, 4) pose of camera 2.
        xn1: normalised image coordinate in camera 1, x.
        yn1: the same, y.
        xn2: normalised image coordinate in camera 2, x.
        yn2: the same, y.

    Returns:
        x, y, z in frame map; NaN if no finite point lies in front of both cameras.

    Source: the inverse-depth form of Civera, Davison, Montiel, 2008, anchored at the first camera.
    """
    # Camera 1 to camera 2: q = R (a, b, 1) + inverse_depth * t, up to scale.
    R = np.empty((3, 3), np.float64)
    t = np.empty(3, np.float64)
    for i in range(3):
        t[i] = T_cam2_map[i, 3]
        for j in range(3):
            R[i, j] = (
                T_cam2_map[i, 0] * T_cam1_map[j, 0]
                + T_cam2_map[i, 1] * T_cam1_map[j, 1]
                + T_cam2_map[i, 2] * T_cam1_map[j, 2]
            )
            t[i] -= R[i, j] * T_cam1_map[j, 3]
    nowhere = (np.nan, np.nan, np.nan)
    a, b = xn1, yn1
    q0 = R[0, 0] * a + R[0, 1] * b + R[0, 2]
    q1 = R[1, 0] * a + R[1, 1] * b + R[1, 2]
    q2 = R[2, 0] * a + R[2, 1] * b + R[2, 2]
    # The inverse depth at which the first ray comes closest to the second observation, linearly.
    du, dv = t[0] - xn2 * t[2], t[1] - yn2 * t[2]
    length = du * du + dv * dv
    if not length > 0.0:
        return nowhere
    inverse_depth = -(du * (q0 - xn2 * q2) + dv * (q1 - yn2 * q2)) / length
    for _ in range(_ITERATIONS):
        q0 = R[0, 0] * a + R[0, 1] * b + R[0, 2] + inverse_depth * t[0]
        q1 = R[1, 0] * a + R[1, 1] * b + R[1, 2] + inverse_depth * t[1]
        q2 = R[2, 0] * a + R[2, 1] * b + R[2, 2] + inverse_depth * t[2]
        if not q2 > _MIN_DEPTH_RATIO:
            return nowhere
        u, v = q0 / q2, q1 / q2
        ja, jb, jc = (R[0, 0] - u * R[2, 0]) / q2, (R[0, 1] - u * R[2, 1]) / q2, (t[0] - u * t[2]) / q2
        ka, kb, kc = (R[1, 0] - v * R[2, 0]) / q2, (R[1, 1] - v * R[2, 1]) / q2, (t[1] - v * t[2]) / q2
        e, f = u - xn2, v - yn2
        ga, gb, gc = a - xn1 + ja * e + ka * f, b - yn1 + jb * e + kb * f, jc * e + kc * f
        # Cholesky of the 3x3 normal matrix, whose first block is identity plus a square.
        l00 = np.sqrt(1.0 + ja * ja + ka * ka)
        l10 = (ja * jb + ka * kb) / l00
        l20 = (ja * jc + ka * kc) / l00
        l11 = np.sqrt(1.0 + jb * jb + kb * kb - l10 * l10)
        l21 = (jb * jc + kb * kc - l20 * l10) / l11
        pivot = jc * jc + kc * kc - l20 * l20 - l21 * l21
        if not pivot > 0.0:
            return nowhere
        y0 = -ga / l00
        y1 = (-gb - l10 * y0) / l11
        dc = (-gc - l20 * y0 - l21 * y1) / pivot
        db = (y1 - l21 * dc) / l11
        da = (y0 - l10 * db - l20 * dc) / l00
        a, b, inverse_depth = a + da, b + db, inverse_depth + dc
        if abs(da) + abs(db) < 1e-10 and abs(dc) < 1e-7 * abs(inverse_depth):
            break
    if not inverse_depth > 1e-12:
        return nowhere
    if not R[2, 0] * a + R[2, 1] * b + R[2, 2] + inverse_depth * t[2] > 0.0:
        return nowhere
    x1 = a / inverse_depth - T_cam1_map[0, 3]
    y1 = b / inverse_depth - T_cam1_map[1, 3]
    z1 = 1.0 / inverse_depth - T_cam1_map[2, 3]
    return (
        T_cam1_map[0, 0] * x1 + T_cam1_map[1, 0] * y1 + T_cam1_map[2, 0] * z1,
        T_cam1_map[0, 1] * x1 + T_cam1_map[1, 1] * y1 + T_cam1_map[2, 1] * z1,
        T_cam1_map[0, 2] * x1 + T_cam1_map[1, 2] * y1 + T_cam1_map[2, 2] * z1,
    )
