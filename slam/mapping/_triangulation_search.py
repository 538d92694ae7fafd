"""New map points of a keyframe: epipolar search in its neighbours, triangulation, checks.

Search and checks follow ORB-SLAM's public code step by step.
"""

import numpy as np
from numba import njit

from dslab.slam.features._hamming import hamming256
from dslab.slam.matching.guided import NEAR
from dslab.slam.optimization._triangulation import fundamental, triangulate

_LEAST_SIGMAS = 2.0  # of their noise, by which two rays must differ


@njit(cache=True, nogil=True)
def surrounding_depths(m, keyframe, around):
    """Depth at which a new point is to be expected at each keypoint of a keyframe.

    Args:
        m: MapArrays.
        keyframe: row.
        around: number of keypoints with points, nearest in the image, whose median inverse depth counts.

    Returns:
        (n_keypoints,) float64; 0 at keypoints that have a point, and at all of a keyframe without any.
    """
    start, size = m.kf_start[keyframe], m.kf_start[keyframe + 1] - m.kf_start[keyframe]
    T = m.kf_T_cam_map[keyframe]
    expected = np.zeros(size, np.float64)
    at = np.empty((size, 2), np.float64)
    inverse = np.empty(size, np.float64)
    n = 0
    for e in range(start, start + size):
        p = m.kp_point[e]
        if p < 0:
            continue
        x = m.pt_xyz[p]
        depth = T[2, 0] * x[0] + T[2, 1] * x[1] + T[2, 2] * x[2] + T[2, 3]
        if depth > 1e-9:
            at[n, 0], at[n, 1], inverse[n] = m.kp_xy[e, 0], m.kp_xy[e, 1], 1.0 / depth
            n += 1
    around = min(around, n)
    if around == 0:
        return expected
    nearest = np.empty(around, np.float64)
    value = np.empty(around, np.float64)
    for i in range(size):
        if m.kp_point[start + i] >= 0:
            continue
        x, y = m.kp_xy[start + i, 0], m.kp_xy[start + i, 1]
        nearest[:] = np.inf
        for j in range(n):
            dx, dy = at[j, 0] - x, at[j, 1] - y
            squared = dx * dx + dy * dy
            if squared >= nearest[-1]:
                continue
            place = around - 1
            while place > 0 and nearest[place - 1] > squared:
                nearest[place], value[place] = nearest[place - 1], value[place - 1]
                place -= 1
            nearest[place], value[place] = squared, inverse[j]
        expected[i] = 1.0 / np.median(value)
    return expected


@njit(cache=True, nogil=True)
def new_points(m, view, keyframe, neighbour, min_depth, expected_depth, min_parallax_cosine, ratio):
    """Match free keypoints of two keyframes along epipolar lines and triangulate them.

    A least parallax that is asked of the measured rays lets in, of the points around that bound, those whose
    noise happens to enlarge it: points that come out too near, from which the scale of a drive shrinks. So
    it is asked at an expected depth, and of the measured rays only that they differ beyond their noise.

    Args:
        m: MapArrays.
        view: ViewGeometry.
        keyframe, neighbour: rows.
        min_depth: least depth of a point in ``keyframe``.
        expected_depth: (n_keypoints,) float64 as of :func:`surrounding_depths`; where it is 0, the least
            parallax is asked of the measured rays.
        min_parallax_cosine: rays with a larger cosine are not triangulated.
        ratio: largest ratio of best to second best descriptor distance.

    Returns:
        keypoints of ``keyframe`` (n,) int32 and of ``neighbour`` (n,) int32 (rows of the keypoint arrays),
        points (n, 3).
    """
    T_1, T_2 = m.kf_T_cam_map[keyframe], m.kf_T_cam_map[neighbour]
    F = fundamental(T_1, T_2, view)
    R_1 = np.ascontiguousarray(T_1[:3, :3])
    R_2 = np.ascontiguousarray(T_2[:3, :3])
    centre_1 = -R_1.T.copy() @ np.ascontiguousarray(T_1[:3, 3])
    centre_2 = -R_2.T.copy() @ np.ascontiguousarray(T_2[:3, 3])
    R_21 = R_2 @ R_1.T.copy()
    t_21 = R_2 @ centre_1 + T_2[:3, 3]
    epipole_x, epipole_y, has_epipole = 0.0, 0.0, t_21[2] > 1e-9
    if has_epipole:
        epipole_x, epipole_y = view.fx * t_21[0] / t_21[2] + view.cx, view.fy * t_21[1] / t_21[2] + view.cy
    size = m.kf_start[keyframe + 1] - m.kf_start[keyframe]
    rows_1 = np.empty(size, np.int32)
    rows_2 = np.empty(size, np.int32)
    points = np.empty((size, 3), np.float64)
    first = m.kf_start[neighbour]
    kp_xy, kp_octave, kp_descriptor, kp_point = m.kp_xy, m.kp_octave, m.kp_descriptor, m.kp_point
    cells = m.kf_cells[neighbour]
    used = np.zeros(m.kf_start[neighbour + 1] - first, np.bool_)
    n = 0
    for a in range(m.kf_start[keyframe], m.kf_start[keyframe + 1]):
        if m.kp_point[a] >= 0:
            continue
        x, y = m.kp_xy[a, 0], m.kp_xy[a, 1]
        la = F[0, 0] * x + F[0, 1] * y + F[0, 2]
        lb = F[1, 0] * x + F[1, 1] * y + F[1, 2]
        lc = F[2, 0] * x + F[2, 1] * y + F[2, 2]
        if la * la + lb * lb < 1e-18:
            continue
        xn, yn = (x - view.cx) / view.fx, (y - view.cy) / view.fy
        dx = R_21[0, 0] * xn + R_21[0, 1] * yn + R_21[0, 2]
        dy = R_21[1, 0] * xn + R_21[1, 1] * yn + R_21[1, 2]
        dz = R_21[2, 0] * xn + R_21[2, 1] * yn + R_21[2, 2]
        if dz < 1e-3:
            continue
        expected = expected_depth[a - m.kf_start[keyframe]]
        if expected > 0 and _parallax_cosine(dx, dy, dz, t_21, expected) > min_parallax_cosine:
            continue
        # The segment of the epipolar line between the least depth and infinity.
        near = max(min_depth, (1e-3 * min_depth - t_21[2]) / dz)
        nz = near * dz + t_21[2]
        x_0 = view.fx * (near * dx + t_21[0]) / nz + view.cx
        y_0 = view.fy * (near * dy + t_21[1]) / nz + view.cy
        x_1, y_1 = view.fx * dx / dz + view.cx, view.fy * dy / dz + view.cy
        found = _best_on_line(
            kp_xy, kp_octave, kp_descriptor, kp_point, m.kp_octave[a], m.kp_descriptor[a], cells, first, used,
            view, la, lb, lc, x_0, y_0, x_1, y_1, has_epipole, epipole_x, epipole_y, ratio,
        )  # fmt: skip
        if found < 0:
            continue
        b = first + found
        most_cosine, sigmas = (1.0, _LEAST_SIGMAS) if expected > 0 else (min_parallax_cosine, 0.0)
        ok, px, py, pz = _triangulated(m, view, T_1, T_2, centre_1, centre_2, a, b, most_cosine, sigmas)
        if ok:
            used[found] = True
            rows_1[n], rows_2[n] = a, b
            points[n, 0], points[n, 1], points[n, 2] = px, py, pz
            n += 1
    return rows_1[:n].copy(), rows_2[:n].copy(), points[:n].copy()


@njit(cache=True, nogil=True)
def _parallax_cosine(dx, dy, dz, t_21, depth):
    """Cosine between the two rays to a point at a depth along the ray (dx, dy, dz), in the second camera."""
    x, y, z = depth * dx + t_21[0], depth * dy + t_21[1], depth * dz + t_21[2]
    return (dx * x + dy * y + dz * z) / np.sqrt((dx * dx + dy * dy + dz * dz) * (x * x + y * y + z * z))


@njit(cache=True, nogil=True)
def _best_on_line(
    kp_xy, kp_octave, kp_descriptor, kp_point, octave, descriptor, cells, first, used,
    view, la, lb, lc, x_0, y_0, x_1, y_1, has_epipole, epipole_x, epipole_y, ratio,
):  # fmt: skip
    """Free keypoint near a segment of a line with the nearest descriptor.

    Takes arrays, not the map: it is called for every keypoint, and a tuple of arrays is expensive to pass.
    """
    norm = la * la + lb * lb
    margin = 1.96 * view.scale[-1]
    c0 = max(int(np.floor((min(x_0, x_1) - margin - view.x_min) / view.cell)), 0)
    c1 = min(int(np.floor((max(x_0, x_1) + margin - view.x_min) / view.cell)), view.cols - 1)
    r0 = max(int(np.floor((min(y_0, y_1) - margin - view.y_min) / view.cell)), 0)
    r1 = min(int(np.floor((max(y_0, y_1) + margin - view.y_min) / view.cell)), view.rows - 1)
    best, second, found = NEAR + 1, 257, -1
    slack = (margin + 1e-6) * np.sqrt(norm)
    for r in range(r0, r1 + 1):
        # Of the row of cells, those that the band around the line crosses; the first and the last row also
        # hold the keypoints beyond them.
        left, right = c0, c1
        if abs(la) > 1e-9 * np.sqrt(norm) and 0 < r < view.rows - 1:
            top, bottom = view.y_min + r * view.cell, view.y_min + (r + 1) * view.cell
            u, v = (-lc - lb * top) / la, (-lc - lb * bottom) / la
            half = slack / abs(la)
            left = max(left, int(np.floor((max(min(u, v) - half, view.x_min) - view.x_min) / view.cell)))
            right = min(right, int(np.floor((min(max(u, v) + half, view.x_max) - view.x_min) / view.cell)))
        if left > right:
            continue
        for i in range(cells[r * view.cols + left], cells[r * view.cols + right + 1]):
            b = first + i
            if used[i] or kp_point[b] >= 0 or abs(octave - kp_octave[b]) > 2:
                continue
            x, y = kp_xy[b, 0], kp_xy[b, 1]
            d_line = la * x + lb * y + lc
            if d_line * d_line * view.inv_sigma2[kp_octave[b]] > 3.84 * norm:
                continue
            if has_epipole:
                # Near the epipole there is hardly any parallax.
                ex, ey = x - epipole_x, y - epipole_y
                if ex * ex + ey * ey < 100.0 * view.scale[kp_octave[b]]:
                    continue
            d = hamming256(descriptor, kp_descriptor[b])
            if d < best:
                second, best, found = best, d, i
            elif d < second:
                second = d
    return found if best <= ratio * second else -1


@njit(cache=True, nogil=True)
def _triangulated(m, view, T_1, T_2, centre_1, centre_2, a, b, min_parallax_cosine, least_sigmas):
    """Triangulate one match; True if it passes all checks, and the point."""
    xn1, yn1 = (m.kp_xy[a, 0] - view.cx) / view.fx, (m.kp_xy[a, 1] - view.cy) / view.fy
    xn2, yn2 = (m.kp_xy[b, 0] - view.cx) / view.fx, (m.kp_xy[b, 1] - view.cy) / view.fy
    dot = 0.0
    for r in range(3):
        ray_1 = T_1[0, r] * xn1 + T_1[1, r] * yn1 + T_1[2, r]
        ray_2 = T_2[0, r] * xn2 + T_2[1, r] * yn2 + T_2[2, r]
        dot += ray_1 * ray_2
    cosine = dot / np.sqrt((xn1 * xn1 + yn1 * yn1 + 1) * (xn2 * xn2 + yn2 * yn2 + 1))
    noise_px2 = 1 / view.inv_sigma2[m.kp_octave[a]] + 1 / view.inv_sigma2[m.kp_octave[b]]
    within_noise = 2.0 * (1.0 - cosine) * view.fx * view.fx < least_sigmas * least_sigmas * noise_px2
    if cosine > min_parallax_cosine or cosine <= 0 or within_noise:
        return False, 0.0, 0.0, 0.0
    px, py, pz = triangulate(T_1, T_2, xn1, yn1, xn2, yn2)
    if not (np.isfinite(px) and np.isfinite(py) and np.isfinite(pz)):
        return False, 0.0, 0.0, 0.0
    if not _reprojects(T_1, view, px, py, pz, m.kp_xy[a], view.inv_sigma2[m.kp_octave[a]]):
        return False, 0.0, 0.0, 0.0
    if not _reprojects(T_2, view, px, py, pz, m.kp_xy[b], view.inv_sigma2[m.kp_octave[b]]):
        return False, 0.0, 0.0, 0.0
    d1 = np.sqrt((px - centre_1[0]) ** 2 + (py - centre_1[1]) ** 2 + (pz - centre_1[2]) ** 2)
    d2 = np.sqrt((px - centre_2[0]) ** 2 + (py - centre_2[1]) ** 2 + (pz - centre_2[2]) ** 2)
    # A larger distance means a finer level: distances and pyramid levels must be consistent.
    seen = view.scale[m.kp_octave[a]] / view.scale[m.kp_octave[b]]
    slack = 1.5 * np.exp(view.log_scale)
    if d2 / d1 * slack < seen or d2 / d1 > seen * slack:
        return False, 0.0, 0.0, 0.0
    return True, px, py, pz


@njit(cache=True, nogil=True)
def _reprojects(T, view, px, py, pz, xy, inv_sigma2):
    z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
    if z <= 0:
        return False
    x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
    y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
    du = view.fx * x / z + view.cx - xy[0]
    dv = view.fy * y / z + view.cy - xy[1]
    return (du * du + dv * dv) * inv_sigma2 <= 5.991
