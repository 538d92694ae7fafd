"""Kernels on the map's flat arrays.

A keyframe's keypoints are one slice of the keypoint arrays. ``kp_point`` is the single owner of the
associations; the observers of a point are a linked list that starts at ``pt_head`` and continues in
``kp_next``. ``covisibility`` is the exact number of shared points of every pair of keyframes.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from dslab.slam.features._hamming import hamming256
from dslab.slam.map._covariance_kernels import refresh_covariance


class MapArrays(NamedTuple):
    """Arrays of a map; capacities exceed the counts, which :class:`slam.map.map.Map` keeps.

    Attributes:
        kf_T_cam_map: (K, 4, 4) float64 keyframe poses.
        kf_start: (K + 1,) int64 first keypoint of each keyframe.
        kf_bad: (K,) bool culled keyframes.
        kf_cells: (K, cells + 1) int32 grid cell starts, relative to the keyframe's first keypoint.
        covisibility: (K, K) int32 shared map points.
        kp_xy: (N, 2) float64 undistorted keypoints, px.
        kp_octave: (N,) int32.
        kp_angle: (N,) float32 degrees.
        kp_descriptor: (N, 4) uint64.
        kp_keyframe: (N,) int32.
        kp_point: (N,) int32, -1 for none.
        kp_next: (N,) int32 next observation of the same point, -1 at the end.
        pt_xyz: (P, 3) float64, map frame.
        pt_normal: (P, 3) float64 mean unit viewing direction, camera to point.
        pt_descriptor: (P, 4) uint64.
        pt_covariance: (P, 6) float64 xx, xy, xz, yy, yz, zz, map frame, poses held, at the view's noise.
        pt_max_distance: (P,) float64, distance at which the point appears on level 0.
        pt_bad: (P,) bool.
        pt_head: (P,) int32 first observation, -1 for none.
        pt_observations: (P,) int32.
        pt_reference: (P,) int32 keyframe that the distances refer to.
        pt_first_keyframe: (P,) int32 keyframe that created it.
        pt_visible, pt_found: (P,) int32 numbers of frames in which it was expected, and was found.
        pt_replaced: (P,) int32 the point that replaces it, -1 for none.
    """

    kf_T_cam_map: np.ndarray
    kf_start: np.ndarray
    kf_bad: np.ndarray
    kf_cells: np.ndarray
    covisibility: np.ndarray
    kp_xy: np.ndarray
    kp_octave: np.ndarray
    kp_angle: np.ndarray
    kp_descriptor: np.ndarray
    kp_keyframe: np.ndarray
    kp_point: np.ndarray
    kp_next: np.ndarray
    pt_xyz: np.ndarray
    pt_normal: np.ndarray
    pt_descriptor: np.ndarray
    pt_covariance: np.ndarray
    pt_max_distance: np.ndarray
    pt_bad: np.ndarray
    pt_head: np.ndarray
    pt_observations: np.ndarray
    pt_reference: np.ndarray
    pt_first_keyframe: np.ndarray
    pt_visible: np.ndarray
    pt_found: np.ndarray
    pt_replaced: np.ndarray


@njit(cache=True, nogil=True)
def observed_in(m, point, keyframe):
    """Keypoint of ``keyframe`` that observes ``point``, -1 for none."""
    e = m.pt_head[point]
    while e >= 0:
        if m.kp_keyframe[e] == keyframe:
            return e
        e = m.kp_next[e]
    return -1


@njit(cache=True, nogil=True)
def add_observation(m, keypoint, point):
    """Associate a keypoint with a point; return False if either is already taken."""
    if m.kp_point[keypoint] >= 0 or m.pt_bad[point]:
        return False
    k = np.int64(m.kp_keyframe[keypoint])
    if observed_in(m, point, k) >= 0:
        return False
    e = m.pt_head[point]
    while e >= 0:
        j = m.kp_keyframe[e]
        m.covisibility[k, j] += 1
        m.covisibility[j, k] += 1
        e = m.kp_next[e]
    m.kp_point[keypoint] = point
    m.kp_next[keypoint] = m.pt_head[point]
    m.pt_head[point] = keypoint
    m.pt_observations[point] += 1
    return True


@njit(cache=True, nogil=True)
def _unlink(m, keypoint):
    point = m.kp_point[keypoint]
    k = m.kp_keyframe[keypoint]
    previous = -1
    e = m.pt_head[point]
    while e != keypoint:
        previous = e
        e = m.kp_next[e]
    if previous < 0:
        m.pt_head[point] = m.kp_next[keypoint]
    else:
        m.kp_next[previous] = m.kp_next[keypoint]
    m.kp_point[keypoint] = -1
    m.kp_next[keypoint] = -1
    m.pt_observations[point] -= 1
    e = m.pt_head[point]
    while e >= 0:
        j = m.kp_keyframe[e]
        m.covisibility[k, j] -= 1
        m.covisibility[j, k] -= 1
        e = m.kp_next[e]
    if m.pt_reference[point] == k and m.pt_head[point] >= 0:
        m.pt_reference[point] = m.kp_keyframe[m.pt_head[point]]


@njit(cache=True, nogil=True)
def remove_point(m, point):
    """Drop a point and all its observations."""
    while m.pt_head[point] >= 0:
        _unlink(m, np.int64(m.pt_head[point]))
    m.pt_bad[point] = True


@njit(cache=True, nogil=True)
def erase_observation(m, keypoint, min_observations):
    """Remove one association; a point left with fewer than ``min_observations`` is dropped."""
    point = np.int64(m.kp_point[keypoint])
    if point < 0:
        return
    _unlink(m, keypoint)
    if m.pt_observations[point] < min_observations:
        remove_point(m, point)


@njit(cache=True, nogil=True)
def refresh_point(m, point, view):
    """Recompute a point's descriptor, mean viewing direction and distance from its observations.

    Of its latest 24 observers, the one nearest to all of them lends its descriptor: the medoid, III-C of
    ORB-SLAM.
    """
    count = m.pt_observations[point]
    if count == 0:
        return
    refresh_geometry(m, point, view)
    rows = np.empty(count, np.int64)
    e = m.pt_head[point]
    for n in range(count):
        rows[n] = e
        e = m.kp_next[e]
    m.pt_descriptor[point] = m.kp_descriptor[rows[_most_central(m, rows)]]


@njit(cache=True, nogil=True)
def refresh_geometry(m, point, view):
    """Recompute a point's mean viewing direction, distance and covariance after it or its observers moved."""
    e = reference = m.pt_head[point]
    nx, ny, nz = 0.0, 0.0, 0.0
    while e >= 0:
        k = np.int64(m.kp_keyframe[e])
        if k == m.pt_reference[point]:
            reference = e
        dx, dy, dz = _from_camera(m, k, point)
        d = np.sqrt(dx * dx + dy * dy + dz * dz)
        nx += dx / d
        ny += dy / d
        nz += dz / d
        e = m.kp_next[e]
    norm = max(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-12)
    m.pt_normal[point, 0] = nx / norm
    m.pt_normal[point, 1] = ny / norm
    m.pt_normal[point, 2] = nz / norm
    dx, dy, dz = _from_camera(m, np.int64(m.kp_keyframe[reference]), point)
    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
    m.pt_max_distance[point] = distance * view.scale[m.kp_octave[reference]]
    refresh_covariance(m, point, view, distance)


@njit(cache=True, nogil=True)
def _from_camera(m, keyframe, point):
    """Vector from a keyframe's camera centre to a point."""
    T = m.kf_T_cam_map[keyframe]
    x, y, z = m.pt_xyz[point]
    for r in range(3):
        t = T[r, 3]
        x += T[r, 0] * t
        y += T[r, 1] * t
        z += T[r, 2] * t
    return x, y, z


@njit(cache=True, nogil=True)
def _most_central(m, rows):
    n = min(len(rows), 24)
    if n <= 2:
        return 0
    distance = np.zeros((n, n), np.int64)
    for i in range(n):
        for j in range(i):
            d = hamming256(m.kp_descriptor[rows[i]], m.kp_descriptor[rows[j]])
            distance[i, j] = d
            distance[j, i] = d
    return np.argmin(distance.sum(axis=1))


@njit(cache=True, nogil=True)
def replace_point(m, old, new, view):
    """Move every observation of ``old`` to ``new`` and drop ``old``."""
    if old == new or m.pt_bad[old] or m.pt_bad[new]:
        return
    while m.pt_head[old] >= 0:
        e = np.int64(m.pt_head[old])
        _unlink(m, e)
        add_observation(m, e, new)
    m.pt_bad[old] = True
    m.pt_replaced[old] = new
    m.pt_found[new] += m.pt_found[old]
    m.pt_visible[new] += m.pt_visible[old]
    refresh_point(m, new, view)


@njit(cache=True, nogil=True)
def replace_points(m, olds, news, view):
    """Apply :func:`replace_point` to index arrays; a new point of -1 keeps the old one."""
    for i in range(len(olds)):
        if news[i] >= 0:
            replace_point(m, np.int64(olds[i]), np.int64(news[i]), view)


@njit(cache=True, nogil=True)
def take_over(m, keyframe, points, view):
    """Add given points per keypoint to a keyframe, -1 for none; join with its own."""
    start = m.kf_start[keyframe]
    for i in range(len(points)):
        p = np.int64(points[i])
        if p < 0:
            continue
        own = np.int64(m.kp_point[start + i])
        if own >= 0:
            replace_point(m, p, own, view)
        elif add_observation(m, start + i, p):
            refresh_point(m, p, view)


@njit(cache=True, nogil=True)
def resolve_points(m, points):
    """Follow replacements in place; dropped points become -1."""
    for i in range(len(points)):
        p = points[i]
        while p >= 0 and m.pt_bad[p]:
            p = m.pt_replaced[p]
        points[i] = p


@njit(cache=True, nogil=True)
def create_point(m, point, xyz, keypoint, view):
    """Fill row ``point`` with a new point first observed by ``keypoint``."""
    keyframe = m.kp_keyframe[keypoint]
    m.pt_xyz[point] = xyz
    m.pt_bad[point] = False
    m.pt_head[point] = -1
    m.pt_observations[point] = 0
    m.pt_reference[point] = keyframe
    m.pt_first_keyframe[point] = keyframe
    m.pt_visible[point] = 1
    m.pt_found[point] = 1
    m.pt_replaced[point] = -1
    add_observation(m, keypoint, point)
    refresh_point(m, point, view)


@njit(cache=True, nogil=True)
def attach_frame(m, keyframe, points, view):
    """Add a frame's matches as observations of its new keyframe and refresh the points."""
    start = m.kf_start[keyframe]
    for i in range(len(points)):
        p = np.int64(points[i])
        if p >= 0 and not m.pt_bad[p] and add_observation(m, start + i, p):
            refresh_point(m, p, view)


@njit(cache=True, nogil=True)
def refresh_points(m, points, view):
    """Apply :func:`refresh_point` to an index array."""
    for i in range(len(points)):
        if not m.pt_bad[points[i]]:
            refresh_point(m, np.int64(points[i]), view)


@njit(cache=True, nogil=True)
def refresh_geometries(m, points, view):
    """Apply :func:`refresh_geometry` to an index array."""
    for i in range(len(points)):
        if not m.pt_bad[points[i]]:
            refresh_geometry(m, np.int64(points[i]), view)


@njit(cache=True, nogil=True)
def detach_keyframe(m, keyframe, min_observations):
    """Remove all observations of a keyframe and mark it culled."""
    for e in range(m.kf_start[keyframe], m.kf_start[keyframe + 1]):
        if m.kp_point[e] >= 0:
            erase_observation(m, e, min_observations)
    m.kf_bad[keyframe] = True


@njit(cache=True, nogil=True)
def count_observed(m, keyframe, min_observations):
    """Number of points of a keyframe with at least ``min_observations`` observers."""
    count = 0
    for e in range(m.kf_start[keyframe], m.kf_start[keyframe + 1]):
        p = m.kp_point[e]
        if p >= 0 and m.pt_observations[p] >= min_observations:
            count += 1
    return count


@njit(cache=True, nogil=True)
def redundant_share(m, keyframe, coarser, view):
    """Share of a keyframe's points of which three others like it know as much without it.

    Args:
        m: MapArrays.
        keyframe: row.
        coarser: whether observations on coarser levels count too, each by its information over the
            keyframe's, 1 / σ²; otherwise those on the same or a finer level count 1 (ORB-SLAM, VI-E).
        view: ViewGeometry.
    """
    total, redundant = 0, 0
    for e in range(m.kf_start[keyframe], m.kf_start[keyframe + 1]):
        p = m.kp_point[e]
        if p < 0:
            continue
        total += 1
        others = 0.0
        o = m.pt_head[p]
        while o >= 0 and others < 3.0:
            if o != e:
                if m.kp_octave[o] <= m.kp_octave[e]:
                    others += 1.0
                elif coarser:
                    others += view.inv_sigma2[m.kp_octave[o]] / view.inv_sigma2[m.kp_octave[e]]
            o = m.kp_next[o]
        redundant += others >= 3.0
    return redundant / total if total else 0.0


@njit(cache=True, nogil=True)
def median_depth(m, keyframe):
    """Median depth of a keyframe's points, 0 without any."""
    start, end = m.kf_start[keyframe], m.kf_start[keyframe + 1]
    depth = np.empty(end - start, np.float64)
    n = 0
    T = m.kf_T_cam_map[keyframe]
    for e in range(start, end):
        p = m.kp_point[e]
        if p >= 0:
            x = m.pt_xyz[p]
            depth[n] = T[2, 0] * x[0] + T[2, 1] * x[1] + T[2, 2] * x[2] + T[2, 3]
            n += 1
    return np.median(depth[:n]) if n else 0.0


@njit(cache=True, nogil=True)
def create_points(m, first, xyz, keypoints_1, keypoints_2, view):
    """Fill rows from ``first`` on with points (n, 3), each observed by two keypoints."""
    for i in range(len(xyz)):
        create_point(m, first + i, xyz[i], np.int64(keypoints_1[i]), view)
        add_observation(m, np.int64(keypoints_2[i]), first + i)
        refresh_point(m, first + i, view)


@njit(cache=True, nogil=True)
def erase_observations(m, keypoints, min_observations):
    """Apply :func:`erase_observation` to an index array."""
    for i in range(len(keypoints)):
        erase_observation(m, np.int64(keypoints[i]), min_observations)


@njit(cache=True, nogil=True)
def remove_points(m, points):
    """Apply :func:`remove_point` to an index array."""
    for i in range(len(points)):
        remove_point(m, np.int64(points[i]))
