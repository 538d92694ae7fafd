"""Loop correction: distribute the similarity over the map and fuse duplicate points.

Source: Mur-Artal, Montiel, Tardos, "ORB-SLAM", 2015, section VII.
"""

from dataclasses import dataclass

import numpy as np

from dslab.slam.loop_closing.essential_graph import optimize_essential_graph
from dslab.slam.loop_closing.supposed import Supposed
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.map import Map
from dslab.slam.mapping.local_mapping import LocalMappingConfig
from dslab.slam.mapping.rules import MapRules, map_rules
from dslab.slam.optimization.sim3_algebra import invert_sim3


@dataclass(frozen=True)
class Loop:
    """A detected loop: a keyframe, placed relative to the loop keyframe's surroundings.

    Attributes:
        keyframe, loop_keyframe: rows.
        S_cam_map: (4, 4) similarity from points around the loop keyframe to the keyframe's camera, in the
            lengths of the keyframe's surroundings.
        rows: (n,) keypoints of the keyframe, from 0, that match points of the loop's side.
        points: (n,) int32 those points.
        supposed: what is believed of it; None if it was not asked.
    """

    keyframe: int
    loop_keyframe: int
    S_cam_map: np.ndarray
    rows: np.ndarray
    points: np.ndarray
    supposed: Supposed | None = None

    @property
    def believed(self) -> float | None:
        """Chance that it is right, when it was last asked; None if it was not."""
        return None if self.supposed is None else self.supposed.believed


def correct_loop(map_: Map, loop: Loop, loop_points: np.ndarray, mapping: LocalMappingConfig) -> np.ndarray:
    """Correct a loop: move the keyframe's surroundings, fuse both sides, optimise the essential graph.

    Args:
        map_: changed in place.
        loop: the detected loop.
        loop_points: (q,) int32 points of the loop's side, matched with the corrected keyframes.
        mapping: settings by which they are.

    Returns:
        (n_keyframes,) scale change of lengths around each keyframe.
    """
    a, n = map_.arrays, map_.n_keyframes
    group = np.append(map_.neighbours(loop.keyframe, n), loop.keyframe)
    before = a.covisibility[group, :n] > 0
    T_before = a.kf_T_cam_map[:n].copy()
    moved = _move_group(map_, group, loop)
    _join(map_, group, loop, loop_points, map_rules(map_, mapping))
    S_start = T_before.copy()
    correction = np.linalg.inv(loop.S_cam_map) @ T_before[loop.keyframe]
    S_start[group] = T_before[group] @ invert_sim3(correction[None])
    edges = _new_edges(map_, group, before, loop)
    a.kf_T_cam_map[:n] = T_before
    S = optimize_essential_graph(map_, S_start, edges, loop.loop_keyframe)
    map_.loop_edges += [(int(i), int(j)) for i, j in edges]
    return move_map(map_, S, S_start, moved)


def _move_group(map_: Map, group: np.ndarray, loop: Loop) -> np.ndarray:
    """Move the keyframes around the loop, and their points, by the loop's similarity.

    Returns:
        (n_points,) int32 keyframe of the group with which a point has moved, -1 for none.
    """
    a = map_.arrays
    D = np.linalg.inv(loop.S_cam_map) @ a.kf_T_cam_map[loop.keyframe]
    moved = np.full(map_.n_points, -1, np.int32)
    for k in group:
        points = map_.observed_points(int(k))
        moved[points[points >= 0]] = k
    rows = np.flatnonzero(moved >= 0)
    mine = a.pt_reference[rows]
    in_group = np.isin(mine, group)
    moved[rows[in_group]] = mine[in_group]
    a.pt_xyz[rows] = a.pt_xyz[rows] @ D[:3, :3].T + D[:3, 3]
    scale = np.cbrt(np.linalg.det(D[:3, :3]))
    R = D[:3, :3] / scale
    for k in group:
        T = a.kf_T_cam_map[k]
        R_new = T[:3, :3] @ R.T
        T[:3, 3] = scale * T[:3, 3] - R_new @ D[:3, 3]
        T[:3, :3] = R_new
    kernels.refresh_geometries(a, rows, map_.view)
    return moved


def _join(map_: Map, group: np.ndarray, loop: Loop, loop_points: np.ndarray, rules: MapRules) -> None:
    """Fuse the matched points, then match the group with all points of the loop's side."""
    a, view = map_.arrays, map_.view
    rows = map_.keypoints(loop.keyframe).start + loop.rows
    for row, point in zip(rows, loop.points, strict=True):
        own = int(a.kp_point[row])
        if own >= 0:
            kernels.replace_point(a, own, int(point), view)
        elif not a.pt_bad[point] and kernels.add_observation(a, int(row), int(point)):
            kernels.refresh_point(a, int(point), view)
    for k in group:
        candidates = loop_points.copy()
        kernels.resolve_points(a, candidates)
        rules.seek(int(k), np.unique(candidates[candidates >= 0]), joining=True)


def _new_edges(map_: Map, group: np.ndarray, before: np.ndarray, loop: Loop) -> np.ndarray:
    """(L, 2) int32 pairs that share points only since the fusion, including the loop itself."""
    n = map_.n_keyframes
    now = map_.arrays.covisibility[group, :n] > 0
    other = np.ones(n, bool)
    other[group] = False
    pairs = [(int(group[i]), int(j)) for i, j in np.argwhere(now & ~before & other)]
    pairs.append((loop.keyframe, loop.loop_keyframe))
    return np.array(sorted(set(pairs)), np.int32)


def move_map(
    map_: Map, S: np.ndarray, S_start: np.ndarray | None = None, moved: np.ndarray | None = None
) -> np.ndarray:
    """Move all keyframes of a map to similarities, and each point with its reference keyframe.

    Args:
        map_: changed in place.
        S: (n_keyframes, 4, 4) similarities from the map to the cameras.
        S_start: (n_keyframes, 4, 4) those from which the points move; None for the keyframes' poses.
        moved: (n_points,) keyframe that a point follows instead, -1 for none.

    Returns:
        (n_keyframes,) scale change of lengths around each keyframe.
    """
    a, rows, points = map_.arrays, map_.keyframes(), map_.points()
    if S_start is None:
        S_start = a.kf_T_cam_map
    reference = np.array([map_.live(int(k)) for k in a.pt_reference[points]], int)
    if moved is not None:
        instead = moved[points] >= 0
        reference[instead] = moved[points[instead]]
    by_reference = invert_sim3(S[rows]) @ S_start[rows]
    slot = np.full(map_.n_keyframes, -1)
    slot[rows] = np.arange(len(rows))
    D = by_reference[slot[reference]]
    a.pt_xyz[points] = np.einsum("nij,nj->ni", D[:, :3, :3], a.pt_xyz[points]) + D[:, :3, 3]
    factor = map_.move_keyframes(S)
    kernels.refresh_geometries(a, points, map_.view)
    return factor
