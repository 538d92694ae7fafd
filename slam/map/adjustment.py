"""Adjustment of a map that may have grown since its copy was adjusted.

Source: Mur-Artal, Tardos, "ORB-SLAM2", 2017, section III-C: the correction is propagated to other keyframes
along the spanning tree.
"""

from dataclasses import dataclass

import numpy as np

from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map._map_kernels import MapArrays
from dslab.slam.map.map import MIN_OBSERVATIONS, Map


@dataclass(frozen=True)
class MapAdjustment:
    """Result of bundle adjustment of a copy of a map.

    Attributes:
        keyframes: (C,) rows.
        T_cam_map: (C, 4, 4) their poses.
        points: (P,) rows.
        xyz: (P, 3) the points.
        outliers: (n, 2) keyframe, and index of its keypoint from 0, of the outlier observations.
        of_points: (n,) int32 the points of these observations.
    """

    keyframes: np.ndarray
    T_cam_map: np.ndarray
    points: np.ndarray
    xyz: np.ndarray
    outliers: np.ndarray
    of_points: np.ndarray


def apply_adjustment(map_: Map, adjustment: MapAdjustment) -> None:
    """Apply the adjustment to the map; newer keyframes and points follow their parents.

    Args:
        map_: the adjusted map, which may have grown since.
        adjustment: its result.
    """
    a = map_.arrays
    before = {int(k): a.kf_T_cam_map[k].copy() for k in map_.keyframes()}
    adjusted = dict(zip(map(int, adjustment.keyframes), adjustment.T_cam_map, strict=True))
    after: dict[int, np.ndarray] = {}
    for k in before:
        _place(map_, k, before, adjusted, after)
    points = map_.points()
    known = np.isin(points, adjustment.points)
    for p in points[~known]:
        k = map_.live(int(a.pt_reference[p]))
        D = np.linalg.inv(after[k]) @ before[k]
        a.pt_xyz[p] = D[:3, :3] @ a.pt_xyz[p] + D[:3, 3]
    still = ~a.pt_bad[adjustment.points]
    a.pt_xyz[adjustment.points[still]] = adjustment.xyz[still]
    for k, T in after.items():
        a.kf_T_cam_map[k] = T
    kernels.erase_observations(a, _still_observed(a, adjustment), MIN_OBSERVATIONS)
    kernels.refresh_geometries(a, map_.points(), map_.view)


def _still_observed(a: MapArrays, adjustment: MapAdjustment) -> np.ndarray:
    """(n,) int32 keypoint rows of the outliers that are still observations."""
    keyframe, index = adjustment.outliers.T
    live = ~a.kf_bad[keyframe]
    rows = a.kf_start[keyframe[live]] + index[live]
    return rows[a.kp_point[rows] == adjustment.of_points[live]].astype(np.int32)


def _place(
    map_: Map,
    keyframe: int,
    before: dict[int, np.ndarray],
    adjusted: dict[int, np.ndarray],
    after: dict[int, np.ndarray],
) -> None:
    """Compute a keyframe's new pose: its own, or relative to its nearest adjusted ancestor."""
    chain = [keyframe]
    while chain[-1] not in adjusted and chain[-1] not in after:
        parent = map_.parent(chain[-1])
        if parent < 0:
            after[chain[-1]] = before[chain[-1]]
            break
        chain.append(map_.live(parent))
    for k in reversed(chain):
        if k in after:
            continue
        if k in adjusted:
            after[k] = adjusted[k]
        else:
            parent = map_.live(map_.parent(k))
            after[k] = before[k] @ np.linalg.inv(before[parent]) @ after[parent]
