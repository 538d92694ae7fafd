"""Essential graph of spanning tree, strong covisibility and loop edges, and its optimisation.

Source: Mur-Artal, Montiel, Tardos, "ORB-SLAM", 2015, sections III-D and VII-C.
"""

import numpy as np

from dslab.slam.map.map import Map
from dslab.slam.optimization.pose_graph import optimize_pose_graph
from dslab.slam.optimization.sim3_algebra import invert_sim3

MIN_SHARED = 100


def essential_edges(map_: Map, min_shared: int = MIN_SHARED) -> np.ndarray:
    """(E, 2) int32 pairs i > j of live keyframes, each pair once, sorted.

    Args:
        map_: left unchanged.
        min_shared: fewest shared points of a covisibility edge.
    """
    rows = map_.keyframes()
    shared = np.tril(map_.arrays.covisibility[: map_.n_keyframes, : map_.n_keyframes], -1)
    pairs = {(int(i), int(j)) for i, j in np.argwhere(shared >= min_shared)}
    tree = [(int(k), map_.live(map_.parent(int(k)))) for k in rows if map_.parent(int(k)) >= 0]
    loops = [(map_.live(i), map_.live(j)) for i, j in map_.loop_edges]
    pairs |= {(max(i, j), min(i, j)) for i, j in (*tree, *loops) if i != j}
    return np.array(sorted(pairs), np.int32).reshape(-1, 2)


def optimize_essential_graph(
    map_: Map, S_start: np.ndarray, loops: np.ndarray, fixed: int, iterations: int = 20
) -> np.ndarray:
    """Distribute a correction over the map's keyframes.

    Old edges are measured by the map's poses, the new ones by the start.

    Args:
        map_: with the poses before the correction; left unchanged.
        S_start: (n_keyframes, 4, 4) similarities camera from map, with the corrected keyframes already
            moved; rows of culled ones are not read.
        loops: (L, 2) the new edges.
        fixed: the fixed keyframe.
        iterations: most steps.

    Returns:
        (n_keyframes, 4, 4) similarities; those of culled keyframes unchanged.
    """
    rows = map_.keyframes()
    slot = np.full(map_.n_keyframes, -1)
    slot[rows] = np.arange(len(rows))
    old = essential_edges(map_)
    new = np.asarray(loops, np.int32).reshape(-1, 2)
    old = old[~_contained(old, new)]
    T = map_.arrays.kf_T_cam_map
    measured = np.concatenate(
        [
            T[old[:, 0]] @ invert_sim3(T[old[:, 1]]),
            S_start[new[:, 0]] @ invert_sim3(S_start[new[:, 1]]),
        ]
    )
    edges = slot[np.concatenate([old, new])]
    result = optimize_pose_graph(S_start[rows], edges, measured, rows == fixed, iterations)
    S = S_start.copy()
    S[rows] = result.S_cam_map
    return S


def _contained(pairs: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(n,) bool mask of the pairs that are in ``others``, in either order."""
    known = {(int(i), int(j)) for i, j in others} | {(int(j), int(i)) for i, j in others}
    return np.array([(int(i), int(j)) in known for i, j in pairs], bool).reshape(-1)
