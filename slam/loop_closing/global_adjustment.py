"""Global bundle adjustment of a map. Source: Mur-Artal, Tardos, "ORB-SLAM2", 2017, section III-C."""

import numpy as np

from dslab.slam.map.adjustment import MapAdjustment
from dslab.slam.map.map import Map
from dslab.slam.mapping._local_problem import local_problem
from dslab.slam.optimization.global_bundle_adjustment import global_bundle_adjust
from dslab.slam.optimization.pose import CHI2_2DOF


def adjust_globally(map_: Map, iterations: int = 10, apart: bool = False) -> MapAdjustment:
    """Run bundle adjustment of all keyframes and points; the map itself is left unchanged.

    Args:
        map_: must not be changed meanwhile.
        iterations: most steps.
        apart: work in a separate process, so that other threads can run.

    Raises:
        ValueError: there are fewer than two keyframes, or no points.
    """
    a, view = map_.arrays, map_.view
    free = ~a.kf_bad[: map_.n_keyframes]
    cameras, points, obs_camera, obs_point, obs_keypoint = local_problem(
        a, map_.n_keyframes, map_.n_points, free, 0
    )
    result = global_bundle_adjust(
        a.kf_T_cam_map[cameras], a.pt_xyz[points], obs_camera, obs_point, a.kp_xy[obs_keypoint],
        a.kp_octave[obs_keypoint], 1.0 / np.sqrt(view.inv_sigma2),
        view.fx, view.fy, view.cx, view.cy, iterations, apart,
    )  # fmt: skip
    rows = obs_keypoint[~(result.chi2 <= CHI2_2DOF)]
    observers = a.kp_keyframe[rows]
    outliers = np.stack([observers, rows - a.kf_start[observers]], axis=1)
    return MapAdjustment(cameras, result.T_cam_map, points, result.points, outliers, a.kp_point[rows].copy())
