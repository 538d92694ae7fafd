"""Residuals of all matches of a frame, none removed as an outlier."""

import numpy as np

from dslab.slam.matching import guided
from dslab.slam.system import MonocularSlam

WIDEN = 3.0
"""Windows of the search over the tracker's own."""


def live_residuals(system: MonocularSlam) -> np.ndarray:
    """Match the last tracked frame with its local map once more, at the pose that was found.

    The tracker removes matches that do not fit, so that what it keeps says nothing of how far they lie off.
    Here the same search runs in wider windows, and everything that it finds counts. Neither map nor tracker
    changes.

    Args:
        system: just after a frame that was tracked and made no keyframe.

    Returns:
        (n,) float64 distances of the keypoints from their points, in sigma of their octave.
    """
    m, last = system.current_map, system.tracker.last
    if last is None:
        return np.empty(0)
    f, T = last.features, np.ascontiguousarray(last.T_cam_map)
    near = system.tracker.config.local_map_keyframes
    known = last.point.copy()
    _, points = guided.collect_local_map(m.arrays, m.n_keyframes, m.n_points, known, near)
    point = np.full(len(f), -1, np.int32)
    guided.match_local_points(
        m.arrays, m.view, T, points, f.xy, f.octave, f.descriptors, f.cell_start, point, WIDEN, 0.8, False
    )
    row = np.flatnonzero(point >= 0)
    p_cam = m.arrays.pt_xyz[point[row]] @ T[:3, :3].T + T[:3, 3]
    v = m.view
    uv = p_cam[:, :2] / p_cam[:, 2:] * (v.fx, v.fy) + (v.cx, v.cy)
    return np.linalg.norm(uv - f.xy[row], axis=1) * np.sqrt(v.inv_sigma2[f.octave[row]])
