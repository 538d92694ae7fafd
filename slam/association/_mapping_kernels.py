"""Kernels of association between keyframes: new points along a ray, and points that are one."""

import numpy as np
from numba import njit

from dslab.slam.association._kernels import (
    OCTAVE_SPREAD,
    camera_at,
    detection,
    expected_view,
    likeliest,
    of_octave,
    spread_of_pixel,
)
from dslab.slam.features._hamming import hamming256
from dslab.slam.map._map_kernels import add_observation, observed_in, refresh_point, replace_point
from dslab.slam.optimization._triangulation import triangulate

BAND = 3.2555
"""Deviations to either side of a line that hold 99 % of Student's t with four degrees of freedom: 4.604 times
its scale, which is the deviation over the root of two."""
_AT_ZERO = 0.5303
"""Its density at 0, of unit variance."""
_AGAIN = 0.5
"""Share of the free keypoints of a keyframe that another one shows too."""
_AROUND = 7
"""Points nearest in the image that say where another one is."""
_LEAST_SPREAD, _OF_SPREAD = 0.01, 0.6
"""The logarithm of a depth over theirs is of Student's t with two degrees of freedom. On the same surface its
scale is this, and so much of the spread of their own logarithms (docs/notebook/base-decides.md)."""
_ELSEWHERE_RAD, _ELSEWHERE = 0.4, 0.4
"""Half of the points so far from those around are of another surface; the scale of the logarithm there."""
_LEAST_DEPTH = 1e-3
"""In the second camera, over that in the first."""


@njit(cache=True, nogil=True, error_model="numpy")
def depths_around(m, view, keyframe):
    """Where the points around each free keypoint of a keyframe say that its own is.

    Args:
        m: MapArrays.
        view: ViewGeometry.
        keyframe: row.

    Returns:
        (n_keypoints, 3): depth, 0 where no point says one; scale of its logarithm on the same surface; chance
        of another surface.
    """
    start, size = m.kf_start[keyframe], m.kf_start[keyframe + 1] - m.kf_start[keyframe]
    T = m.kf_T_cam_map[keyframe]
    found = np.zeros((size, 3))
    at, depth = np.empty((size, 2)), np.empty(size)
    n = 0
    for e in range(start, start + size):
        p = m.kp_point[e]
        if p >= 0:
            z = T[2, 0] * m.pt_xyz[p, 0] + T[2, 1] * m.pt_xyz[p, 1] + T[2, 2] * m.pt_xyz[p, 2] + T[2, 3]
            if z > 1e-9:
                at[n, 0], at[n, 1], depth[n] = m.kp_xy[e, 0], m.kp_xy[e, 1], z
                n += 1
    around = min(_AROUND, n)
    if around == 0:
        return found
    away, value = np.empty(around), np.empty(around)
    for i in range(size):
        if m.kp_point[start + i] >= 0:
            continue
        x, y = m.kp_xy[start + i, 0], m.kp_xy[start + i, 1]
        away[:] = np.inf
        for j in range(n):
            squared = (at[j, 0] - x) ** 2 + (at[j, 1] - y) ** 2
            if squared < away[-1]:
                place = around - 1
                while place > 0 and away[place - 1] > squared:
                    away[place], value[place] = away[place - 1], value[place - 1]
                    place -= 1
                away[place], value[place] = squared, depth[j]
        ordered = np.sort(value)
        outer = around // 6  # of seven the outermost two say nothing of the spread
        spread = 0.5 * np.log(ordered[around - 1 - outer] / ordered[outer])
        found[i, 0] = ordered[around // 2]
        found[i, 1] = np.sqrt(_LEAST_SPREAD**2 + (_OF_SPREAD * spread) ** 2)
        apart = np.sqrt(away.mean()) / view.fx
        found[i, 2] = apart / (apart + _ELSEWHERE_RAD)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def points_along_rays(
    m, view, keyframe, neighbour, noise2, min_depth, around, max_error, density, odds, least
):
    """Find free keypoints of a keyframe again in another one, along their rays, and triangulate them.

    A ray is searched if at the depth of the points around, or without any at the depth that is found, that
    depth would be known well enough: to ask it of the depth that is found would choose those that their noise
    has brought near.

    Args:
        m: MapArrays.
        view: ViewGeometry.
        keyframe, neighbour: rows.
        noise2: variance of the keypoints over what the view says.
        min_depth: least depth of a point in ``keyframe``.
        around: (n_keypoints, 3) as of :func:`depths_around`.
        max_error: largest standard deviation of a depth over itself.
        density: (levels,) keypoints per px² of every octave of ``neighbour``.
        odds: (257,) by distance of descriptors.
        least: posterior of the place from which a pair is taken.

    Returns:
        keypoints of ``keyframe`` (n,) int32 and of ``neighbour`` (n,) int32 (rows of the keypoint arrays),
        points (n, 3).
    """
    T_1, T_2 = m.kf_T_cam_map[keyframe], m.kf_T_cam_map[neighbour]
    R = np.ascontiguousarray(T_2[:3, :3]) @ np.ascontiguousarray(T_1[:3, :3].T)
    t = T_2[:3, 3] - R @ np.ascontiguousarray(T_1[:3, 3])
    start, end = m.kf_start[keyframe], m.kf_start[keyframe + 1]
    first = m.kf_start[neighbour]
    free = m.kp_point[first : m.kf_start[neighbour + 1]] < 0
    rows_1, rows_2 = np.empty(end - start, np.int32), np.empty(end - start, np.int32)
    points, there = np.empty((end - start, 3)), np.empty((len(free), 3))
    n = 0
    for a in range(start, end):
        if m.kp_point[a] >= 0:
            continue
        x, y = (m.kp_xy[a, 0] - view.cx) / view.fx, (m.kp_xy[a, 1] - view.cy) / view.fy
        d = R[:, 0] * x + R[:, 1] * y + R[:, 2]
        expected, scale, elsewhere = around[a - start]
        own = noise2 / view.inv_sigma2[m.kp_octave[a]]
        if d[2] < _LEAST_DEPTH or (expected > 0 and _error(view, d, t, 1.0 / expected, own, own) > max_error):
            continue
        found = _along_ray(
            view, m.kp_xy, m.kp_octave, m.kp_descriptor, m.kf_cells[neighbour], first, free,
            np.int64(m.kp_octave[a]), m.kp_descriptor[a], d, t, np.sqrt(x * x + y * y + 1.0), noise2, own,
            min_depth, expected, scale, elsewhere, max_error, density, odds, least, there,
        )  # fmt: skip
        if found < 0:
            continue
        b = first + found
        px, py, pz = triangulate(
            T_1, T_2, x, y, (m.kp_xy[b, 0] - view.cx) / view.fx, (m.kp_xy[b, 1] - view.cy) / view.fy
        )
        if np.isfinite(px + py + pz):
            free[found] = False
            rows_1[n], rows_2[n] = a, b
            points[n, 0], points[n, 1], points[n, 2] = px, py, pz
            n += 1
    return rows_1[:n].copy(), rows_2[:n].copy(), points[:n].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def _error(view, d, t, inverse, noise_a, noise_b):
    """Standard deviation of an inverse depth over itself, from two keypoints; infinite behind a camera.

    Args:
        view: ViewGeometry.
        d, t: (3,) ray of the first camera in the second, at unit depth, and the first camera's position.
        inverse: depth in the first camera, inverted.
        noise_a, noise_b: variances of the keypoints, px².
    """
    z = d[2] + inverse * t[2]
    if z <= _LEAST_DEPTH or inverse <= 0:
        return np.inf
    u, v = (d[0] + inverse * t[0]) / z, (d[1] + inverse * t[1]) / z
    along = np.hypot(view.fx * (t[0] - u * t[2]), view.fy * (t[1] - v * t[2])) / z
    return np.sqrt(noise_a / (z * z) + noise_b) / max(along * inverse, 1e-12)


@njit(cache=True, nogil=True, error_model="numpy")
def ray_in_view(view, d, t, min_depth):
    """Where a ray of one camera is seen by another one.

    At the inverse depth i it is seen at P + s W, with P where it is seen at infinity, W what a pixel moves by
    at first, and s = i / (d_z + i t_z). So the keypoints to look at lie in a band about a segment.

    Args:
        view: ViewGeometry.
        d, t: (3,) the ray in the other camera, at unit depth, and the first camera's position; d_z > 0.
        min_depth: in the first camera.

    Returns:
        P_u, P_v, W_u, W_v; s of the nearest point, and its inverse depth.
    """
    P_u, P_v = view.fx * d[0] / d[2] + view.cx, view.fy * d[1] / d[2] + view.cy
    W_u, W_v = view.fx * (t[0] - d[0] / d[2] * t[2]), view.fy * (t[1] - d[1] / d[2] * t[2])
    nearest = 1.0 / min_depth
    if t[2] < 0:  # in front of the second camera too
        nearest = min(nearest, (d[2] - _LEAST_DEPTH) / -t[2])
    return P_u, P_v, W_u, W_v, nearest / (d[2] + nearest * t[2]), nearest


@njit(cache=True, nogil=True, error_model="numpy")
def columns_along(view, r, P_u, P_v, W_u, W_v, s_end, margin):
    """First and last column of cells of a row that a band about the segment P + s W, s to s_end, crosses.

    The outer rows and columns hold what lies beyond them; the last is before the first if there are none.
    """
    s_0, s_1 = 0.0, s_end
    top = -np.inf if r == 0 else view.y_min + r * view.cell - margin
    bottom = np.inf if r == view.rows - 1 else view.y_min + (r + 1) * view.cell + margin
    if W_v > 0:
        s_0, s_1 = max(s_0, (top - P_v) / W_v), min(s_1, (bottom - P_v) / W_v)
    elif W_v < 0:
        s_0, s_1 = max(s_0, (bottom - P_v) / W_v), min(s_1, (top - P_v) / W_v)
    elif not top < P_v < bottom:
        return 0, -1
    if s_0 > s_1:
        return 0, -1
    u_0, u_1 = P_u + s_0 * W_u, P_u + s_1 * W_u
    return _column(view, min(u_0, u_1) - margin), _column(view, max(u_0, u_1) + margin)


@njit(cache=True, nogil=True, error_model="numpy")
def _along_ray(
    view, kp_xy, kp_octave, kp_descriptor, cells, first, free, octave, descriptor, d, t, length, noise2, own,
    min_depth, expected, scale, elsewhere, max_error, density, odds, least, there,
):  # fmt: skip
    """Free keypoint that shows the point of a ray, by the posterior of its place; -1 for none.

    Asked is where the point is, not which keypoint shows it. A corner has several, of neighbouring octaves:
    those whose depths agree within their noise count together, and the likeliest is taken. ``there`` is
    (n, 3) of room for as many keypoints as may be free.
    """
    P_u, P_v, W_u, W_v, s_end, nearest = ray_in_view(view, d, t, min_depth)
    W = np.sqrt(W_u * W_u + W_v * W_v)
    if W < 1e-9:
        return -1
    along_u, along_v = W_u / W, W_v / W
    margin = BAND * np.sqrt(2.0 * noise2 / view.inv_sigma2[-1])
    total, best, found = 1.0 - _AGAIN, 0.0, -1
    n, best_at, best_variance = 0, 0.0, 0.0
    for r in range(view.rows):
        left, right = columns_along(view, r, P_u, P_v, W_u, W_v, s_end, margin)
        if left > right:
            continue
        for i in range(cells[r * view.cols + left], cells[r * view.cols + right + 1]):
            if not free[i]:
                continue
            b = first + i
            du, dv = kp_xy[b, 0] - P_u, kp_xy[b, 1] - P_v
            off = along_u * dv - along_v * du
            if abs(off) > margin:
                continue
            s = (along_u * du + along_v * dv) / W
            if not 0 < s <= s_end:
                continue
            inverse = s * d[2] / (1.0 - s * t[2])
            z = d[2] + inverse * t[2]
            other = noise2 / view.inv_sigma2[kp_octave[b]]
            variance = own / (z * z) + other
            if off * off > BAND * BAND * variance:
                continue
            if expected <= 0 and _error(view, d, t, inverse, own, other) > max_error:
                continue
            px, py = d[0] + inverse * t[0], d[1] + inverse * t[1]
            away = np.sqrt(px * px + py * py + z * z) / length
            apart = kp_octave[b] - octave + np.log(away) / view.log_scale
            if abs(apart) > 3.0 * OCTAVE_SPREAD:
                continue
            likely = (
                _AGAIN
                * _of_inverse_depth(inverse, expected, scale, elsewhere, nearest)
                / (W * d[2] / (z * z))
            )
            tails = 1.0 + 0.5 * off * off / variance
            likely *= _AT_ZERO / (tails * tails * np.sqrt(variance * tails))
            likely *= (
                of_octave(apart) * odds[hamming256(descriptor, kp_descriptor[b])] / density[kp_octave[b]]
            )
            total += likely
            there[n] = s * W, variance, likely
            n += 1
            if likely > best:
                best, found, best_at, best_variance = likely, i, s * W, variance
    here = 0.0
    for at, variance, likely in there[:n]:
        if (at - best_at) ** 2 <= BAND * BAND * (best_variance + variance):
            here += likely
    return found if here >= least * total else -1


@njit(cache=True, nogil=True, error_model="numpy")
def _column(view, u):
    """Column of cells in which a keypoint lies; the outer ones hold what lies beyond them."""
    return int(min(max((u - view.x_min) / view.cell, 0.0), view.cols - 1.0))


@njit(cache=True, nogil=True, error_model="numpy")
def _of_inverse_depth(inverse, expected, scale, elsewhere, nearest):
    """Density of an inverse depth: by the points around, or anywhere up to the nearest."""
    if expected <= 0:
        return 1.0 / nearest
    z = np.log(inverse * expected)
    same, other = 1.0 + 0.5 * (z / scale) ** 2, 1.0 + 0.5 * (z / _ELSEWHERE) ** 2
    density = (1.0 - elsewhere) / (scale * same * np.sqrt(same))
    density += elsewhere / (_ELSEWHERE * other * np.sqrt(other))
    return 0.35355 * density / inverse


@njit(cache=True, nogil=True, error_model="numpy")
def fuse_points(m, view, keyframe, candidates, noise2, density, odds, least):
    """Find points in a keyframe that does not observe them yet; those that are one become one.

    A point found at a free keypoint gains an observation; of two at one keypoint that of which more is known
    stays, with the observations of both.

    Args:
        m: MapArrays, changed in place.
        view: ViewGeometry.
        keyframe: row.
        candidates: (Q,) int32 points.
        noise2: variance of the keypoints over what the view says.
        density: (levels,) keypoints per px² of every octave of the keyframe.
        odds: (257,) by distance of descriptors.
        least: posterior from which a pair is taken.

    Returns:
        Number of observations added plus points fused.
    """
    T = m.kf_T_cam_map[keyframe]
    first = m.kf_start[keyframe]
    exact, centre, J = np.zeros((6, 6)), camera_at(T), np.zeros((2, 6))
    done = 0
    for q in range(len(candidates)):
        p = np.int64(candidates[q])
        if p < 0 or m.pt_bad[p] or observed_in(m, p, keyframe) >= 0:
            continue
        u, v, level = expected_view(view, T, centre, m.pt_xyz[p], m.pt_normal[p], m.pt_max_distance[p])
        if np.isnan(level):
            continue
        u, v, _, uu, uv, vv = spread_of_pixel(view, T, m.pt_xyz[p], m.pt_covariance[p], noise2, exact, J)
        i, posterior, _, _ = likeliest(
            view, m.kp_xy, m.kp_octave, m.kp_descriptor, m.kf_cells[keyframe], first, u, v, uu, uv, vv,
            noise2, level, density, detection(m.pt_found[p], m.pt_visible[p]), m.pt_descriptor[p], odds,
        )  # fmt: skip
        if i < 0 or posterior < least:
            continue
        e = first + i
        other = np.int64(m.kp_point[e])
        if other < 0:
            if add_observation(m, e, p):
                refresh_point(m, p, view)
        elif _variance(m.pt_covariance[other]) < _variance(m.pt_covariance[p]):
            replace_point(m, p, other, view)
        else:
            replace_point(m, other, p, view)
        done += 1
    return done


@njit(cache=True, nogil=True, error_model="numpy")
def _variance(covariance):
    """Trace of a symmetric (3, 3) in its six numbers."""
    return covariance[0] + covariance[3] + covariance[5]


@njit(cache=True, nogil=True, error_model="numpy")
def unobserved_in(m, view, keyframes, points):
    """Number of points (Q,) int32, -1 for none, that each keyframe (K,) should show and does not observe.

    Returns:
        (K,) int64.
    """
    count = np.zeros(len(keyframes), np.int64)
    for n in range(len(keyframes)):
        k = np.int64(keyframes[n])
        T = m.kf_T_cam_map[k]
        centre = camera_at(T)
        for p in points:
            if p < 0 or m.pt_bad[p]:
                continue
            _, _, level = expected_view(view, T, centre, m.pt_xyz[p], m.pt_normal[p], m.pt_max_distance[p])
            if not np.isnan(level) and observed_in(m, np.int64(p), k) < 0:
                count[n] += 1
    return count
