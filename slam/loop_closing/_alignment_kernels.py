"""Guided matching between two maps related by a similarity."""

import numpy as np
from numba import njit

from dslab.slam.matching.guided import FAR, in_view, nearest_in_window, predicted_octave, project


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
        taken: (n_keypoints,) bool keypoints that must not be used; extended in place.
        radius: half side of the search window on level 0, px.

    Returns:
        (Q,) int32 keypoint row within the keyframe, -1 for none.
    """
    matched = np.full(len(candidates), -1, np.int32)
    first = m_into.kf_start[keyframe]
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
        if distance > 1.2 * far or distance < 0.8 * far / view.scale[-1]:
            continue
        level = predicted_octave(view, far, distance)
        i, d = nearest_in_window(
            view, m_into.kp_xy, m_into.kp_octave, m_into.kp_descriptor, m_into.kf_cells[keyframe], first,
            taken, u, v, radius * view.scale[level], level - 1, level + 1, m_from.pt_descriptor[p], 0.9,
        )  # fmt: skip
        if i >= 0 and d <= FAR:
            matched[q] = i
            taken[i] = True
    return matched
