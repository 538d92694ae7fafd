"""Removal of culled keyframes' keypoints from a map, to make room for new ones."""

import numpy as np

from dslab.slam.map._map_kernels import MapArrays


def culled_keypoints(a: MapArrays, n_keyframes: int) -> int:
    """Number of keypoints in use that belong to culled keyframes."""
    return int(np.diff(a.kf_start[: n_keyframes + 1])[a.kf_bad[:n_keyframes]].sum())


def drop_culled_keypoints(a: MapArrays, n_keyframes: int, n_points: int) -> None:
    """Remove the keypoints of culled keyframes, in place.

    Keypoints and the observers of every point keep their order; only row numbers change. Results computed
    from the map stay the same.

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
