"""Points that a view should show, if it is where it is supposed to be, and what it shows of them."""

import numpy as np
from numba import njit

from dslab.slam.matching.projection import in_view, project
from dslab.slam.matching.window import nearest

_BORDER_PX = 20.0  # no features are extracted nearer to the border of an image
_MIN_COSINE = 0.8  # between the direction of view and a point's mean one
_SAME = 70  # largest distance of two descriptors of one point, bits
# Change of view at which a point is found half as often as where it was seen, measured in ordinary tracking
# of recorded footage: an angle, rad, and a factor of the distance, as its logarithm to base 2.
_HALF_ANGLE = np.deg2rad(9.0)
_HALF_ZOOM = 0.8
_LEAST_CHANCE = 0.1  # to find a point that is there; below, it is as likely found where it is not


@njit(cache=True, nogil=True)
def look_for(m, view, S_cam_map, scale, candidates, xy, octave, descriptors, cell_start, first, radius, near):
    """Project points into a view by a supposed similarity, and look for them there.

    Args:
        m: MapArrays of the points.
        view: ViewGeometry.
        S_cam_map: (4, 4) similarity from the points' map to the camera; its lengths are the view's.
        scale: its scale factor.
        candidates: (Q,) int32 points.
        xy, octave, descriptors, cell_start: features of the view; its rows start at ``first``.
        first: see there.
        radius: radius of the search window on level 0, px.
        near: whether a point is expected only as far as a keyframe has seen it from near this view.

    Returns:
        Of the n points that the view should show: rows (n,) int32, pixels (n, 2), depths (n,) in the view's
        lengths, chance (n,) to find each, which is the share of the frames in which it was found so far, with
        ``near`` less, and the keypoint within the view that shows it (n,) int32, -1 for none.
    """
    size = len(candidates)
    rows = np.empty(size, np.int32)
    pixels = np.empty((size, 2))
    depths = np.empty(size)
    likely = np.empty(size)
    keypoint = np.empty(size, np.int32)
    R = S_cam_map[:3, :3] / scale
    t = S_cam_map[:3, 3]
    centre = np.empty(3)
    for r in range(3):
        centre[r] = -(R[0, r] * t[0] + R[1, r] * t[1] + R[2, r] * t[2]) / scale
    n = 0
    for p in candidates:
        if m.pt_bad[p]:
            continue
        u, v, z = project(S_cam_map, view, m.pt_xyz[p])
        if z <= 0 or not in_view(view, u, v):
            continue
        if not (view.x_min + _BORDER_PX <= u < view.x_max - _BORDER_PX):
            continue
        if not (view.y_min + _BORDER_PX <= v < view.y_max - _BORDER_PX):
            continue
        distance, along = 0.0, 0.0
        for r in range(3):
            c, d = t[r], 0.0
            for s in range(3):
                c += scale * R[r, s] * m.pt_xyz[p, s]
                d += R[r, s] * m.pt_normal[p, s]
            distance += c * c
            along += c * d
        distance = np.sqrt(distance)
        far = scale * m.pt_max_distance[p]
        if distance > far or distance < far / view.scale[-1] or along < _MIN_COSINE * distance:
            continue
        chance = (m.pt_found[p] + 1.0) / (m.pt_visible[p] + 2.0)
        if near:
            chance *= _familiarity(m, p, centre)
            if chance < _LEAST_CHANCE:
                continue
        level = np.ceil(np.log(far / distance) / view.log_scale)
        i, d = nearest(
            view, xy, octave, descriptors, cell_start, first, u, v, radius * view.scale[int(level)],
            level - 1.0, level + 1.0, m.pt_descriptor[p],
        )  # fmt: skip
        rows[n] = p
        pixels[n, 0], pixels[n, 1], depths[n] = u, v, z
        likely[n] = chance
        keypoint[n] = i if i >= 0 and d <= _SAME else -1
        n += 1
    return rows[:n].copy(), pixels[:n].copy(), depths[:n].copy(), likely[:n].copy(), keypoint[:n].copy()


@njit(cache=True, nogil=True)
def _familiarity(m, point, centre):
    """Share of its usual chance to be found that a point has, seen from ``centre`` (3,)."""
    least = np.inf
    e = m.pt_head[point]
    while e >= 0:
        T = m.kf_T_cam_map[m.kp_keyframe[e]]
        along, here, there = 0.0, 0.0, 0.0
        for r in range(3):
            c = 0.0
            for s in range(3):
                c -= T[s, r] * T[s, 3]
            v, w = m.pt_xyz[point, r] - centre[r], m.pt_xyz[point, r] - c
            along += v * w
            here += v * v
            there += w * w
        angle = np.arccos(min(max(along / np.sqrt(here * there), -1.0), 1.0))
        zoom = 0.5 * np.log2(here / there)
        least = min(least, (angle / _HALF_ANGLE) ** 2 + (zoom / _HALF_ZOOM) ** 2)
        e = m.kp_next[e]
    return 1.0 / (1.0 + least**0.75)
