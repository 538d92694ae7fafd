"""Guided matching between two maps related by a similarity."""

import numpy as np
from numba import njit

from dslab.slam.matching.projection import in_view, project
from dslab.slam.matching.window import GUIDED_BITS, nearest


@njit(cache=True, nogil=True)
def match_across(m_from, candidates, S_cam_from, scale, m_into, view, keyframe, taken, radius):
    """Find points of one map in a keyframe of another.

    Args:
        m_from: MapArrays of the points.
        candidates: (Q,) int32 points.
        S_cam_from: (4, 4) similarity from that map to the keyframe's camera, lengths of the other map.
        scale: its scale factor.
        m_into: MapArrays of the keyframe.
        view: ViewGeometry.
        keyframe: row in ``m_into``.
        taken: (n_keypoints,) bool keypoints that must not be used.
        radius: of the search window on level 0, px.

    Returns:
        (Q,) int32 keypoint row within the keyframe, -1 for none. Of two points at one keypoint that is
        taken which looks more like it.
    """
    matched = np.full(len(candidates), -1, np.int32)
    first = m_into.kf_start[keyframe]
    held, by = np.where(taken, 0, GUIDED_BITS + 1), np.full(len(taken), -1, np.int64)
    for q in range(len(candidates)):
        p = candidates[q]
        u, v, z = project(S_cam_from, view, m_from.pt_xyz[p])
        if z <= 0 or not in_view(view, u, v):
            continue
        xyz = m_from.pt_xyz[p]
        distance = 0.0
        for r in range(3):
            c = S_cam_from[r, 3]
            for s in range(3):
                c += S_cam_from[r, s] * xyz[s]
            distance += c * c
        distance = np.sqrt(distance)
        far = scale * m_from.pt_max_distance[p]
        level = np.log(far / distance) / view.log_scale
        if not -1.0 <= level < len(view.scale):
            continue
        level = np.ceil(level)
        i, bits = nearest(
            view, m_into.kp_xy, m_into.kp_octave, m_into.kp_descriptor, m_into.kf_cells[keyframe], first,
            u, v, radius * view.scale[min(max(int(level), 0), len(view.scale) - 1)], level - 1.0, level + 1.0,
            m_from.pt_descriptor[p],
        )  # fmt: skip
        if i >= 0 and bits < held[i]:
            if by[i] >= 0:
                matched[by[i]] = -1
            matched[q], held[i], by[i] = i, bits, q
    return matched
