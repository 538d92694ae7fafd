"""Guided search of ORB-SLAM, by its paper.

Source: Mur-Artal, Montiel, Tardós, "ORB-SLAM: a versatile and accurate monocular SLAM system", IEEE Trans.
Robotics 31(5), 2015; roman numbers are its sections. A number for which it says nothing is that by which
descriptions of its release know it; each says so.
"""

import numpy as np
from numba import njit

from dslab.slam.map._map_kernels import add_observation, observed_in, refresh_point, replace_point
from dslab.slam.matching.projection import in_view, project
from dslab.slam.matching.window import FREE_BITS, GUIDED_BITS, nearest

_MIN_COSINE = 0.5  # V-D, 2: an angle of 60°


@njit(cache=True, nogil=True)
def expected_at(m, view, T, point):
    """Where a view should show a point, V-D, steps 1 to 4: (u, v, level, a fraction); NaN if it should not.

    The limits of distance are those at which the point is on the finest and on the coarsest level, III-C, and
    a level beyond them: that on which it was seen is rounded.
    """
    u, v, z = project(T, view, m.pt_xyz[point])
    if z <= 0 or not in_view(view, u, v):
        return 0.0, 0.0, np.nan
    squared, along = 0.0, 0.0
    for r in range(3):
        from_camera = m.pt_xyz[point, r]
        for c in range(3):
            from_camera += T[c, r] * T[c, 3]
        squared += from_camera * from_camera
        along += from_camera * m.pt_normal[point, r]
    distance = np.sqrt(squared)
    level = np.log(m.pt_max_distance[point] / distance) / view.log_scale
    if along < _MIN_COSINE * distance or not -1.0 <= level < len(view.scale):
        return 0.0, 0.0, np.nan
    return u, v, level


@njit(cache=True, nogil=True)
def search_last_frame(
    m, view, T_cam_map, last_point, last_octave, xy, octave, descriptors, cell_start, radius
):  # fmt: skip
    """Find the points of the last frame in the next one, V-B.

    A keypoint that looks most like two points is that of the one which it looks more like.

    Args:
        m: MapArrays.
        view: ViewGeometry.
        T_cam_map: (4, 4) predicted pose.
        last_point, last_octave: the last frame's associations and levels.
        xy, octave, descriptors, cell_start: the next frame.
        radius: of the window around a prediction on the finest level, px.

    Returns:
        (N,) int32 point per keypoint of the next frame, -1 for none.
    """
    point = np.full(len(octave), -1, np.int32)
    held = np.full(len(octave), GUIDED_BITS + 1, np.int64)
    for j in range(len(last_point)):
        p = last_point[j]
        if p < 0:
            continue
        u, v, z = project(T_cam_map, view, m.pt_xyz[p])
        if z <= 0 or not in_view(view, u, v):
            continue
        level = last_octave[j]
        i, bits = nearest(
            view, xy, octave, descriptors, cell_start, np.int64(0), u, v, radius * view.scale[level],
            level - 1.0, level + 1.0, m.pt_descriptor[p],
        )  # fmt: skip
        if i >= 0 and bits < held[i]:
            point[i], held[i] = p, bits
    return point


@njit(cache=True, nogil=True)
def search_local_map(
    m, view, T_cam_map, candidates, xy, octave, descriptors, cell_start, point, radius, observing
):  # fmt: skip
    """Find points of the local map in a frame, V-D: at the still unmatched keypoints.

    Args:
        m: MapArrays.
        view: ViewGeometry.
        T_cam_map: (4, 4) pose.
        candidates: (Q,) int32 points.
        xy, octave, descriptors, cell_start: the frame.
        point: (N,) int32 associations; extended in place.
        radius: of the window around a prediction on the finest level, px.
        observing: count the points in view as visible.
    """
    held = np.where(point >= 0, 0, GUIDED_BITS + 1)
    present = np.zeros(len(m.pt_bad), np.bool_)
    for p in point:
        if p >= 0:
            present[p] = True
    for p in candidates:
        if present[p]:
            m.pt_visible[p] += observing
            continue
        u, v, level = expected_at(m, view, T_cam_map, np.int64(p))
        if np.isnan(level):
            continue
        m.pt_visible[p] += observing
        i, bits = nearest(
            view, xy, octave, descriptors, cell_start, np.int64(0), u, v, radius * view.scale[int(level)],
            np.floor(level), np.ceil(level), m.pt_descriptor[p],
        )  # fmt: skip
        if i >= 0 and bits < held[i]:
            point[i], held[i] = p, bits


@njit(cache=True, nogil=True)
def search_keyframe(m, view, keyframe, candidates, radius):
    """Find points in a keyframe that does not observe them yet, VI-C by V-D; join those that are one, VII-C.

    Of two points at one keypoint that with more observations stays.

    Args:
        m: MapArrays, changed in place.
        view: ViewGeometry.
        keyframe: row.
        candidates: (Q,) int32 points.
        radius: of the window around a prediction on the finest level, px.
    """
    T = m.kf_T_cam_map[keyframe]
    first = m.kf_start[keyframe]
    for q in range(len(candidates)):
        p = np.int64(candidates[q])
        if m.pt_bad[p] or observed_in(m, p, keyframe) >= 0:
            continue
        u, v, level = expected_at(m, view, T, p)
        if np.isnan(level):
            continue
        i, bits = nearest(
            view, m.kp_xy, m.kp_octave, m.kp_descriptor, m.kf_cells[keyframe], first, u, v,
            radius * view.scale[int(level)], np.floor(level), np.ceil(level), m.pt_descriptor[p],
        )  # fmt: skip
        if i < 0 or bits > FREE_BITS:
            continue
        e = first + i
        other = np.int64(m.kp_point[e])
        if other < 0:
            add_observation(m, e, p)
            refresh_point(m, p, view)
        elif m.pt_observations[other] >= m.pt_observations[p]:
            replace_point(m, p, other, view)
        else:
            replace_point(m, other, p, view)
