"""Room in a map for new keypoints: those of culled keyframes are taken out."""

import numpy as np

from slam.map._map_kernels import MapArrays


def culled_keypoints(a: MapArrays, n_keyframes: int) -> int:
    """Keypoints in use that belong to culled keyframes."""
    return int(np.diff(a.kf_start[: n_keyframes + 1])[a.kf_bad[:n_keyframes]].sum())


def drop_culled_keypoints(a: MapArrays, n_keyframes: int, n_points: int) -> None:
    """Move the keypoints of live keyframes together, in place; a culled keyframe is left with none.

    Keypoints keep their order, and so do the observers of every point: nothing that is computed from the
    map changes by it. Their row numbers do.

    Args:
        a: the map's arrays; no point is observed by a culled keyframe.
        n_keyframes, n_points: rows in use.
    """
    used = int(a.kf_start[n_keyframes])
    kept = ~a.kf_bad[a.kp_keyframe[:used]]
    moved_to = np.cumsum(kept) - 1
    end = int(kept.sum())
    for links in (a.kp_next[:used], a.pt_head[:n_points]):
        linked = links >= 0
        links[linked] = moved_to[links[linked]]
    for array in (a.kp_xy, a.kp_octave, a.kp_angle, a.kp_descriptor, a.kp_keyframe, a.kp_point, a.kp_next):
        array[:end] = array[:used][kept]
    a.kp_point[end:used] = a.kp_next[end:used] = -1
    counts = np.diff(a.kf_start[: n_keyframes + 1])
    counts[a.kf_bad[:n_keyframes]] = 0
    a.kf_start[1 : n_keyframes + 1] = np.cumsum(counts)
