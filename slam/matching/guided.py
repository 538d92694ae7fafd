"""Guided matching of map points with keypoints: project, search nearby cells, compare descriptors.

It follows ORB-SLAM's public code step by step.
"""

import numpy as np
from numba import njit

from dslab.slam.features._hamming import hamming256
from dslab.slam.map._map_kernels import add_observation, observed_in, refresh_point, replace_point
from dslab.slam.matching.orientation import keep_common_turn

FAR = 100  # largest distance of a guided match, bits
NEAR = 50  # largest distance of an unguided match, bits


@njit(cache=True, nogil=True)
def project(T_cam_map, view, xyz):
    """Pixel and depth of a map point: (u, v, z); z <= 0 behind the camera."""
    x, y, z = xyz[0], xyz[1], xyz[2]
    xc = T_cam_map[0, 0] * x + T_cam_map[0, 1] * y + T_cam_map[0, 2] * z + T_cam_map[0, 3]
    yc = T_cam_map[1, 0] * x + T_cam_map[1, 1] * y + T_cam_map[1, 2] * z + T_cam_map[1, 3]
    zc = T_cam_map[2, 0] * x + T_cam_map[2, 1] * y + T_cam_map[2, 2] * z + T_cam_map[2, 3]
    if zc <= 1e-9:
        return 0.0, 0.0, -1.0
    return view.fx * xc / zc + view.cx, view.fy * yc / zc + view.cy, zc


@njit(cache=True, nogil=True)
def in_view(view, u, v):
    """Return True if a pixel lies within the undistorted image."""
    return view.x_min <= u < view.x_max and view.y_min <= v < view.y_max


@njit(cache=True, nogil=True)
def predicted_octave(view, max_distance, distance):
    """Pyramid level on which a point is expected at a distance."""
    level = int(np.ceil(np.log(max_distance / distance) / view.log_scale))
    return min(max(level, 0), len(view.scale) - 1)


@njit(cache=True, nogil=True)
def nearest_in_window(
    view, xy, octave, descriptors, cell_start, first, taken, u, v, radius, low, high, query, ratio
):
    """Find the keypoint with the nearest descriptor within a window.

    Args:
        view: ViewGeometry.
        xy, octave, descriptors: keypoint arrays; the frame's rows start at ``first``.
        cell_start: the frame's grid, relative to ``first``.
        taken: (n,) bool per keypoint of the frame, skipped where True.
        u, v, radius: centre and half side of the window, px.
        low, high: pyramid levels searched, inclusive.
        query: (4,) uint64 descriptor.
        ratio: largest ratio of best to second best distance, if both are on one level.

    Returns:
        (row within the frame or -1, distance in bits).
    """
    best, second = 257, 257
    best_octave, second_octave = -1, -1
    found = -1
    c0 = max(int((u - radius - view.x_min) / view.cell), 0)
    c1 = min(int((u + radius - view.x_min) / view.cell), view.cols - 1)
    r0 = max(int((v - radius - view.y_min) / view.cell), 0)
    r1 = min(int((v + radius - view.y_min) / view.cell), view.rows - 1)
    if u + radius < view.x_min or v + radius < view.y_min or c0 >= view.cols or r0 >= view.rows:
        return -1, 257
    for r in range(r0, r1 + 1):
        for i in range(cell_start[r * view.cols + c0], cell_start[r * view.cols + c1 + 1]):
            e = first + i
            if taken[i] or octave[e] < low or octave[e] > high:
                continue
            if abs(xy[e, 0] - u) > radius or abs(xy[e, 1] - v) > radius:
                continue
            d = hamming256(query, descriptors[e])
            if d < best:
                second, second_octave = best, best_octave
                best, best_octave, found = d, octave[e], i
            elif d < second:
                second, second_octave = d, octave[e]
    if found >= 0 and best_octave == second_octave and best > ratio * second:
        return -1, 257
    return found, best


@njit(cache=True, nogil=True)
def match_last_frame(
    m,
    view,
    T_cam_map,
    last_point,
    last_octave,
    last_angle,
    xy,
    octave,
    angle,
    descriptors,
    cell_start,
    radius,
):
    """Find the map points of the last frame in the current one.

    Args:
        m: MapArrays.
        view: ViewGeometry.
        T_cam_map: (4, 4) predicted pose.
        last_point, last_octave, last_angle: the last frame's associations and keypoints.
        xy, octave, angle, descriptors, cell_start: the current frame.
        radius: half side of the search window on level 0, px.

    Returns:
        point (N,) int32 matched map point per keypoint, count.
    """
    n = len(octave)
    point = np.full(n, -1, np.int32)
    turn = np.zeros(n, np.float64)
    taken = np.zeros(n, np.bool_)
    for j in range(len(last_point)):
        p = last_point[j]
        if p < 0:
            continue
        u, v, z = project(T_cam_map, view, m.pt_xyz[p])
        if z <= 0 or not in_view(view, u, v):
            continue
        level = last_octave[j]
        i, d = nearest_in_window(
            view, xy, octave, descriptors, cell_start, np.int64(0), taken, u, v, radius * view.scale[level],
            level - 1, level + 1, m.pt_descriptor[p], 1.0,
        )  # fmt: skip
        if i >= 0 and d <= FAR:
            point[i] = p
            taken[i] = True
            turn[i] = last_angle[j] - angle[i]
    return point, keep_common_turn(point, turn)


@njit(cache=True, nogil=True)
def match_local_points(
    m, view, T_cam_map, candidates, xy, octave, descriptors, cell_start, point, widen, ratio, count_visible
):
    """Match more points of the local map with a frame of known pose.

    Args:
        m: MapArrays.
        view: ViewGeometry.
        T_cam_map: (4, 4) pose.
        candidates: (Q,) int32 map points.
        xy, octave, descriptors, cell_start: the frame.
        point: (N,) int32 associations; extended in place.
        widen: factor on the search radius.
        ratio: see :func:`nearest_in_window`.
        count_visible: also count the points in view as visible.

    Returns:
        (points expected in view, matches added).
    """
    taken = point >= 0
    present = {np.int32(-1)}
    for i in range(len(point)):
        if point[i] >= 0:
            present.add(point[i])
    R = np.ascontiguousarray(T_cam_map[:3, :3])
    t = T_cam_map[:3, 3]
    ox = -(R[0, 0] * t[0] + R[1, 0] * t[1] + R[2, 0] * t[2])
    oy = -(R[0, 1] * t[0] + R[1, 1] * t[1] + R[2, 1] * t[2])
    oz = -(R[0, 2] * t[0] + R[1, 2] * t[1] + R[2, 2] * t[2])
    expected, added = 0, 0
    for q in range(len(candidates)):
        p = candidates[q]
        if p in present:
            expected += 1
            m.pt_visible[p] += count_visible
            continue
        u, v, z = project(T_cam_map, view, m.pt_xyz[p])
        if z <= 0 or not in_view(view, u, v):
            continue
        dx, dy, dz = m.pt_xyz[p, 0] - ox, m.pt_xyz[p, 1] - oy, m.pt_xyz[p, 2] - oz
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        far = m.pt_max_distance[p]
        if distance > 1.2 * far or distance < 0.8 * far / view.scale[-1]:
            continue
        cosine = (dx * m.pt_normal[p, 0] + dy * m.pt_normal[p, 1] + dz * m.pt_normal[p, 2]) / distance
        if cosine < 0.5:
            continue
        expected += 1
        m.pt_visible[p] += count_visible
        level = predicted_octave(view, far, distance)
        radius = (2.5 if cosine > 0.998 else 4.0) * widen * view.scale[level]
        i, d = nearest_in_window(
            view, xy, octave, descriptors, cell_start, np.int64(0), taken, u, v, radius,
            level - 1, level, m.pt_descriptor[p], ratio,
        )  # fmt: skip
        if i >= 0 and d <= FAR:
            point[i] = p
            taken[i] = True
            added += 1
    return expected, added


@njit(cache=True, nogil=True)
def fuse_into_keyframe(m, view, keyframe, candidates, widen):
    """Match map points with a keyframe that does not observe them yet; fuse duplicates.

    A point matched with a free keypoint gains an observation; one matched with another point's keypoint is
    fused with that point, and the one with more observations is kept.

    Args:
        m: MapArrays, changed in place.
        view: ViewGeometry.
        keyframe: row.
        candidates: (Q,) int32 map points.
        widen: search radius on level 0, px.

    Returns:
        Number of observations added plus points fused.
    """
    T = m.kf_T_cam_map[keyframe]
    first = m.kf_start[keyframe]
    count = m.kf_start[keyframe + 1] - first
    nothing_taken = np.zeros(count, np.bool_)
    ox = -(T[0, 0] * T[0, 3] + T[1, 0] * T[1, 3] + T[2, 0] * T[2, 3])
    oy = -(T[0, 1] * T[0, 3] + T[1, 1] * T[1, 3] + T[2, 1] * T[2, 3])
    oz = -(T[0, 2] * T[0, 3] + T[1, 2] * T[1, 3] + T[2, 2] * T[2, 3])
    done = 0
    for q in range(len(candidates)):
        p = np.int64(candidates[q])
        if p < 0 or m.pt_bad[p] or observed_in(m, p, keyframe) >= 0:
            continue
        u, v, z = project(T, view, m.pt_xyz[p])
        if z <= 0 or not in_view(view, u, v):
            continue
        dx, dy, dz = m.pt_xyz[p, 0] - ox, m.pt_xyz[p, 1] - oy, m.pt_xyz[p, 2] - oz
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        far = m.pt_max_distance[p]
        if distance > 1.2 * far or distance < 0.8 * far / view.scale[-1]:
            continue
        cosine = (dx * m.pt_normal[p, 0] + dy * m.pt_normal[p, 1] + dz * m.pt_normal[p, 2]) / distance
        if cosine < 0.5:
            continue
        level = predicted_octave(view, far, distance)
        i, d = nearest_in_window(
            view, m.kp_xy, m.kp_octave, m.kp_descriptor, m.kf_cells[keyframe], first, nothing_taken, u, v,
            widen * view.scale[level], level - 1, level, m.pt_descriptor[p], 1.0,
        )  # fmt: skip
        if i < 0 or d > NEAR:
            continue
        e = first + i
        du, dv = m.kp_xy[e, 0] - u, m.kp_xy[e, 1] - v
        if (du * du + dv * dv) * view.inv_sigma2[m.kp_octave[e]] > 5.991:
            continue
        other = np.int64(m.kp_point[e])
        if other < 0:
            if add_observation(m, e, p):
                refresh_point(m, p, view)
        elif m.pt_observations[other] > m.pt_observations[p]:
            replace_point(m, p, other, view)
        else:
            replace_point(m, other, p, view)
        done += 1
    return done
