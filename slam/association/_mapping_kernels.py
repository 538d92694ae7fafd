"""Kernels of association between keyframes: new points along a ray, and points that are one."""

import numpy as np
from numba import njit

from dslab.slam.association._kernels import likeliest, spread_of_pixel
from dslab.slam.features._hamming import hamming256
from dslab.slam.map._map_kernels import add_observation, observed_in, refresh_point, replace_point
from dslab.slam.matching.guided import in_view
from dslab.slam.optimization._triangulation import fundamental, triangulate

_BAND = 2.58
"""Standard deviations to either side of a line that hold 99 %."""
_OCTAVE_SPREAD = 1.0
"""Standard deviation of the octave of a keypoint about that of another one of the same point."""
_AGAIN = 0.5
"""Share of the free keypoints of a keyframe that another one shows too."""
_AROUND, _ANYWHERE = 0.3, 0.2
"""Spread of the logarithm of depth about that of the points around, and the share that has any depth."""
_MIN_COSINE = 0.5
"""Between the direction of view and a point's mean one: Mur-Artal et al., 2015, V-D."""


@njit(cache=True, nogil=True)
def points_along_rays(
    m, view, keyframe, neighbour, noise2, min_depth, expected_depth, max_error, density, odds, least
):
    """Find free keypoints of a keyframe again in another one, along epipolar lines, and triangulate them.

    A ray is searched if at the depth of the points around, or without any at the depth that is found, that
    depth would be known well enough: to ask it of the depth that is found would choose those that their noise
    has brought near.

    Args:
        m: MapArrays.
        view: ViewGeometry.
        keyframe, neighbour: rows.
        noise2: variance of the keypoints over what the view says.
        min_depth: least depth of a point in ``keyframe``.
        expected_depth: (n_keypoints,) of the points around each keypoint, 0 where there are none.
        max_error: largest standard deviation of a depth over itself.
        density: (levels,) keypoints per px² of every octave of ``neighbour``.
        odds: (257,) by distance of descriptors.
        least: posterior from which a pair is taken.

    Returns:
        keypoints of ``keyframe`` (n,) int32 and of ``neighbour`` (n,) int32 (rows of the keypoint arrays),
        points (n, 3).
    """
    T_1, T_2 = m.kf_T_cam_map[keyframe], m.kf_T_cam_map[neighbour]
    F = fundamental(T_1, T_2, view)
    R = np.ascontiguousarray(T_2[:3, :3]) @ np.ascontiguousarray(T_1[:3, :3].T)
    t = T_2[:3, 3] - R @ np.ascontiguousarray(T_1[:3, 3])
    start, end = m.kf_start[keyframe], m.kf_start[keyframe + 1]
    first = m.kf_start[neighbour]
    used = np.zeros(m.kf_start[neighbour + 1] - first, np.bool_)
    rows_1, rows_2 = np.empty(end - start, np.int32), np.empty(end - start, np.int32)
    points = np.empty((end - start, 3))
    n = 0
    for a in range(start, end):
        if m.kp_point[a] >= 0:
            continue
        x, y = (m.kp_xy[a, 0] - view.cx) / view.fx, (m.kp_xy[a, 1] - view.cy) / view.fy
        d = R[:, 0] * x + R[:, 1] * y + R[:, 2]
        expected = expected_depth[a - start]
        noise_a = noise2 / view.inv_sigma2[m.kp_octave[a]]
        if expected > 0 and _error(view, d, t, 1.0 / expected, noise_a, noise_a) > max_error:
            continue
        found = _along_ray(
            view, m.kp_xy, m.kp_octave, m.kp_descriptor, m.kp_point, m.kf_cells[neighbour], first, used, a,
            F, d, t, np.sqrt(x * x + y * y + 1.0), noise2, noise_a, min_depth, expected, max_error, density,
            odds, least,
        )  # fmt: skip
        if found < 0:
            continue
        b = first + found
        px, py, pz = triangulate(
            T_1, T_2, x, y, (m.kp_xy[b, 0] - view.cx) / view.fx, (m.kp_xy[b, 1] - view.cy) / view.fy
        )
        if np.isfinite(px + py + pz):
            used[found] = True
            rows_1[n], rows_2[n] = a, b
            points[n, 0], points[n, 1], points[n, 2] = px, py, pz
            n += 1
    return rows_1[:n].copy(), rows_2[:n].copy(), points[:n].copy()


@njit(cache=True, nogil=True)
def _error(view, d, t, inverse, noise_a, noise_b):
    """Standard deviation of an inverse depth over itself, from two keypoints; infinite behind a camera.

    Args:
        view: ViewGeometry.
        d, t: (3,) ray of the first camera in the second, at unit depth, and the first camera's position.
        inverse: depth in the first camera, inverted.
        noise_a, noise_b: variances of the keypoints, px².
    """
    z = d[2] + inverse * t[2]
    if z <= 1e-3 or inverse <= 0:
        return np.inf
    u, v = (d[0] + inverse * t[0]) / z, (d[1] + inverse * t[1]) / z
    along = np.hypot(view.fx * (t[0] - u * t[2]), view.fy * (t[1] - v * t[2])) / z
    return np.sqrt(noise_a / (z * z) + noise_b) / max(along * inverse, 1e-12)


@njit(cache=True, nogil=True)
def _along_ray(
    view, kp_xy, kp_octave, kp_descriptor, kp_point, cells, first, used, a, F, d, t, length, noise2,
    noise_a, min_depth, expected, max_error, density, odds, least,
):  # fmt: skip
    """Free keypoint that shows the same point as keypoint ``a``, by its posterior; -1 for none."""
    x, y = kp_xy[a, 0], kp_xy[a, 1]
    la = F[0, 0] * x + F[0, 1] * y + F[0, 2]
    lb = F[1, 0] * x + F[1, 1] * y + F[1, 2]
    lc = F[2, 0] * x + F[2, 1] * y + F[2, 2]
    norm = np.sqrt(la * la + lb * lb)
    if norm < 1e-9 or d[2] < 1e-3:
        return -1
    nearest = 1.0 / max(min_depth, (1e-3 * min_depth - t[2]) / d[2])  # in front of both
    z = d[2] + nearest * t[2]
    x_0 = view.fx * (d[0] + nearest * t[0]) / z + view.cx
    y_0 = view.fy * (d[1] + nearest * t[1]) / z + view.cy
    x_1, y_1 = view.fx * d[0] / d[2] + view.cx, view.fy * d[1] / d[2] + view.cy
    margin = _BAND * np.sqrt(2.0 * noise2 / view.inv_sigma2[-1])
    c0 = max(int(np.floor((min(x_0, x_1) - margin - view.x_min) / view.cell)), 0)
    c1 = min(int(np.floor((max(x_0, x_1) + margin - view.x_min) / view.cell)), view.cols - 1)
    r0 = max(int(np.floor((min(y_0, y_1) - margin - view.y_min) / view.cell)), 0)
    r1 = min(int(np.floor((max(y_0, y_1) + margin - view.y_min) / view.cell)), view.rows - 1)
    total, best, found = 1.0 - _AGAIN, 0.0, -1
    for r in range(r0, r1 + 1):
        # Of the row of cells those that the band about the line crosses; the first and the last row also hold
        # the keypoints beyond them.
        left, right = c0, c1
        if abs(la) > 1e-9 * norm and 0 < r < view.rows - 1:
            top, bottom = view.y_min + r * view.cell, view.y_min + (r + 1) * view.cell
            u, v = (-lc - lb * top) / la, (-lc - lb * bottom) / la
            half = margin * norm / abs(la)
            left = max(left, int(np.floor((max(min(u, v) - half, view.x_min) - view.x_min) / view.cell)))
            right = min(right, int(np.floor((min(max(u, v) + half, view.x_max) - view.x_min) / view.cell)))
        if left > right:
            continue
        for i in range(cells[r * view.cols + left], cells[r * view.cols + right + 1]):
            b = first + i
            if used[i] or kp_point[b] >= 0:
                continue
            off = (la * kp_xy[b, 0] + lb * kp_xy[b, 1] + lc) / norm
            if abs(off) > margin:
                continue
            # The inverse depth at which the ray comes closest to the keypoint.
            xb, yb = (kp_xy[b, 0] - view.cx) / view.fx, (kp_xy[b, 1] - view.cy) / view.fy
            du, dv = t[0] - xb * t[2], t[1] - yb * t[2]
            inverse = -(du * (d[0] - xb * d[2]) + dv * (d[1] - yb * d[2])) / (du * du + dv * dv)
            z = d[2] + inverse * t[2]
            if not 0 < inverse <= nearest or z <= 1e-3:
                continue
            noise_b = noise2 / view.inv_sigma2[kp_octave[b]]
            variance = noise_a / (z * z) + noise_b
            if off * off > _BAND * _BAND * variance:
                continue
            if expected <= 0 and _error(view, d, t, inverse, noise_a, noise_b) > max_error:
                continue
            u, v = (d[0] + inverse * t[0]) / z, (d[1] + inverse * t[1]) / z
            speed = np.hypot(view.fx * (t[0] - u * t[2]), view.fy * (t[1] - v * t[2])) / z  # px per 1/depth
            away = np.sqrt((d[0] + inverse * t[0]) ** 2 + (d[1] + inverse * t[1]) ** 2 + z * z) / length
            apart = kp_octave[b] - kp_octave[a] + np.log(away) / view.log_scale
            if abs(apart) > 3.0 * _OCTAVE_SPREAD:
                continue
            likely = _AGAIN * _of_inverse_depth(inverse, expected, nearest) / speed
            likely *= 0.3989 / np.sqrt(variance) * np.exp(-0.5 * off * off / variance)
            likely *= 0.3989 / _OCTAVE_SPREAD * np.exp(-0.5 * (apart / _OCTAVE_SPREAD) ** 2)
            likely *= odds[hamming256(kp_descriptor[a], kp_descriptor[b])] / density[kp_octave[b]]
            total += likely
            if likely > best:
                best, found = likely, i
    return found if best >= least * total else -1


@njit(cache=True, nogil=True)
def _of_inverse_depth(inverse, expected, nearest):
    """Density of an inverse depth: about that of the points around, or anywhere up to the nearest."""
    anywhere = 1.0 / nearest
    if expected <= 0:
        return anywhere
    z = np.log(inverse * expected) / _AROUND
    return (1.0 - _ANYWHERE) * 0.3989 / (_AROUND * inverse) * np.exp(-0.5 * z * z) + _ANYWHERE * anywhere


@njit(cache=True, nogil=True)
def fuse_points(m, view, keyframe, candidates, noise2, density, odds, least):
    """Find points in a keyframe that does not observe them yet; those that are one become one.

    A point found at a free keypoint gains an observation; one found at another point's keypoint is fused with
    that point, and the one with more observations is kept.

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
    exact = np.zeros((6, 6))
    ox = -(T[0, 0] * T[0, 3] + T[1, 0] * T[1, 3] + T[2, 0] * T[2, 3])
    oy = -(T[0, 1] * T[0, 3] + T[1, 1] * T[1, 3] + T[2, 1] * T[2, 3])
    oz = -(T[0, 2] * T[0, 3] + T[1, 2] * T[1, 3] + T[2, 2] * T[2, 3])
    done = 0
    for q in range(len(candidates)):
        p = np.int64(candidates[q])
        if p < 0 or m.pt_bad[p] or observed_in(m, p, keyframe) >= 0:
            continue
        u, v, z, uu, uv, vv = spread_of_pixel(view, T, m.pt_xyz[p], m.pt_covariance[p] * noise2, exact)
        if z <= 0 or not in_view(view, u, v):
            continue
        dx, dy, dz = m.pt_xyz[p, 0] - ox, m.pt_xyz[p, 1] - oy, m.pt_xyz[p, 2] - oz
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        along = dx * m.pt_normal[p, 0] + dy * m.pt_normal[p, 1] + dz * m.pt_normal[p, 2]
        level = np.log(m.pt_max_distance[p] / distance) / view.log_scale
        if along < _MIN_COSINE * distance or not -1.5 <= level <= len(view.scale) + 0.5:
            continue
        detected = min((m.pt_found[p] + 4.0) / (m.pt_visible[p] + 5.0), 0.99)
        i, posterior, _, _ = likeliest(
            view, m.kp_xy, m.kp_octave, m.kp_descriptor, m.kf_cells[keyframe], first, u, v, uu, uv, vv,
            noise2, level, density, detected, m.pt_descriptor[p], odds,
        )  # fmt: skip
        if i < 0 or posterior < least:
            continue
        e = first + i
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
