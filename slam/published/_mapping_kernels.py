"""New points of ORB-SLAM, by its paper.

Source: as of ``slam.published._search_kernels``, section VI-C.
"""

import numpy as np
from numba import njit

from dslab.slam.association._mapping_kernels import columns_along, ray_in_view
from dslab.slam.features._hamming import hamming256
from dslab.slam.matching.projection import project
from dslab.slam.optimization._triangulation import triangulate
from dslab.slam.published._search_kernels import FREE_BITS

_CHI2_1, _CHI2_2 = 3.84, 5.99  # χ² at 95 % of one and of two degrees of freedom
_SAME_SCALE = 1.8  # factor by which the ratio of distances may differ from that of scales: release
_LEAST_AHEAD = 1e-3


@njit(cache=True, nogil=True)
def new_points(m, view, keyframe, neighbour, min_depth, parallax_cosine):
    """Match the unmatched keypoints of two keyframes that fulfil the epipolar constraint, and triangulate.

    Args:
        m: MapArrays.
        view: ViewGeometry.
        keyframe, neighbour: rows.
        min_depth: least depth of a point in ``keyframe``.
        parallax_cosine: rays with a larger cosine have too little parallax.

    Returns:
        keypoints of ``keyframe`` (n,) int32 and of ``neighbour`` (n,) int32 (rows of the keypoint arrays),
        points (n, 3).
    """
    T_1, T_2 = m.kf_T_cam_map[keyframe], m.kf_T_cam_map[neighbour]
    R = np.ascontiguousarray(T_2[:3, :3]) @ np.ascontiguousarray(T_1[:3, :3].T)
    t = T_2[:3, 3] - R @ np.ascontiguousarray(T_1[:3, 3])
    start, end, first = m.kf_start[keyframe], m.kf_start[keyframe + 1], m.kf_start[neighbour]
    free = m.kp_point[first : m.kf_start[neighbour + 1]] < 0
    rows_1, rows_2 = np.empty(end - start, np.int32), np.empty(end - start, np.int32)
    points = np.empty((end - start, 3))
    n = 0
    for a in range(start, end):
        if m.kp_point[a] >= 0:
            continue
        x, y = (m.kp_xy[a, 0] - view.cx) / view.fx, (m.kp_xy[a, 1] - view.cy) / view.fy
        d = R[:, 0] * x + R[:, 1] * y + R[:, 2]
        if d[2] < _LEAST_AHEAD:
            continue
        found = _nearest_on_line(
            view, m.kp_xy, m.kp_octave, m.kp_descriptor, m.kf_cells[neighbour], first, free,
            m.kp_descriptor[a], d, t, min_depth,
        )  # fmt: skip
        if found < 0:
            continue
        xyz = _triangulated(m, view, T_1, T_2, a, first + found, parallax_cosine)
        if np.isfinite(xyz[0]):
            free[found] = False
            rows_1[n], rows_2[n], points[n] = a, first + found, xyz
            n += 1
    return rows_1[:n].copy(), rows_2[:n].copy(), points[:n].copy()


@njit(cache=True, nogil=True)
def _nearest_on_line(
    view, kp_xy, kp_octave, kp_descriptor, cells, first, free, descriptor, d, t, min_depth
):  # fmt: skip
    """Free keypoint on the epipolar line of a ray that looks most like another one; -1 for none."""
    P_u, P_v, W_u, W_v, s_end, _ = ray_in_view(view, d, t, min_depth)
    W2 = W_u * W_u + W_v * W_v
    margin = np.sqrt(_CHI2_1 / view.inv_sigma2[-1])
    best, found = FREE_BITS + 1, -1
    for r in range(view.rows if W2 > 1e-18 else 0):
        left, right = columns_along(view, r, P_u, P_v, W_u, W_v, s_end, margin)
        if left > right:
            continue
        for i in range(cells[r * view.cols + left], cells[r * view.cols + right + 1]):
            b = first + i
            du, dv = kp_xy[b, 0] - P_u, kp_xy[b, 1] - P_v
            off = W_u * dv - W_v * du
            along = W_u * du + W_v * dv
            if not free[i] or not 0.0 < along <= s_end * W2:
                continue
            if off * off * view.inv_sigma2[kp_octave[b]] > _CHI2_1 * W2:
                continue
            bits = hamming256(descriptor, kp_descriptor[b])
            if bits < best:
                best, found = bits, i
    return found


@njit(cache=True, nogil=True)
def _triangulated(m, view, T_1, T_2, a, b, parallax_cosine):
    """(3,) point of two keypoints, NaN if it is not accepted: depth, parallax, reprojection and scale."""
    nothing = np.full(3, np.nan)
    xyz = np.empty(3)
    xyz[0], xyz[1], xyz[2] = triangulate(
        T_1, T_2, (m.kp_xy[a, 0] - view.cx) / view.fx, (m.kp_xy[a, 1] - view.cy) / view.fy,
        (m.kp_xy[b, 0] - view.cx) / view.fx, (m.kp_xy[b, 1] - view.cy) / view.fy,
    )  # fmt: skip
    if not np.isfinite(xyz.sum()):
        return nothing
    between, squared = 0.0, np.zeros(2)
    for r in range(3):
        from_1, from_2 = xyz[r], xyz[r]
        for c in range(3):
            from_1 += T_1[c, r] * T_1[c, 3]
            from_2 += T_2[c, r] * T_2[c, 3]
        between += from_1 * from_2
        squared[0] += from_1 * from_1
        squared[1] += from_2 * from_2
    if between > parallax_cosine * np.sqrt(squared[0] * squared[1]):
        return nothing
    for T, e in ((T_1, a), (T_2, b)):
        u, v, z = project(T, view, xyz)
        du, dv = u - m.kp_xy[e, 0], v - m.kp_xy[e, 1]
        if z <= 0 or (du * du + dv * dv) * view.inv_sigma2[m.kp_octave[e]] > _CHI2_2:
            return nothing
    nearer = np.sqrt(squared[1] / squared[0]) * view.scale[m.kp_octave[b]] / view.scale[m.kp_octave[a]]
    return xyz if 1.0 / _SAME_SCALE < nearer < _SAME_SCALE else nothing
