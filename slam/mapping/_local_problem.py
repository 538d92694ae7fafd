"""Kernel that collects the arrays of a local bundle adjustment from a map."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def local_problem(m, n_keyframes, n_points, is_free, max_fixed):
    """Collect the bundle adjustment problem of a set of free keyframes.

    Points are those that a free keyframe sees; the other keyframes that see them are fixed, at most
    ``max_fixed``, those with most of the points first.

    Args:
        m: MapArrays.
        n_keyframes, n_points: counts.
        is_free: (n_keyframes,) bool.
        max_fixed: most fixed keyframes.

    Returns:
        cameras (C,) int32 keyframes (free first), points (P,) int32, obs_camera (M,) int32, obs_point (M,)
        int32 (both into the former), obs_keypoint (M,) int32.
    """
    in_points = np.zeros(n_points, np.bool_)
    seen = np.zeros(n_keyframes, np.int64)
    n_pts, n_obs = 0, 0
    for k in range(n_keyframes):
        if not is_free[k]:
            continue
        for e in range(m.kf_start[k], m.kf_start[k + 1]):
            p = m.kp_point[e]
            if p < 0 or in_points[p]:
                continue
            in_points[p] = True
            n_pts += 1
            o = m.pt_head[p]
            while o >= 0:
                seen[m.kp_keyframe[o]] += 1
                n_obs += 1
                o = m.kp_next[o]
    outer = np.argsort(-np.where(is_free, 0, seen), kind="mergesort")[:max_fixed]
    camera_of = np.full(n_keyframes, -1, np.int32)
    cameras = np.empty(n_keyframes, np.int32)
    n_cam = 0
    for k in range(n_keyframes):
        if is_free[k]:
            camera_of[k] = n_cam
            cameras[n_cam] = k
            n_cam += 1
    for k in outer:
        if seen[k] > 0 and not is_free[k]:
            camera_of[k] = n_cam
            cameras[n_cam] = k
            n_cam += 1
    points = np.empty(n_pts, np.int64)
    obs_camera = np.empty(n_obs, np.int32)
    obs_point = np.empty(n_obs, np.int32)
    obs_keypoint = np.empty(n_obs, np.int32)
    i, n = 0, 0
    for p in range(n_points):
        if not in_points[p]:
            continue
        points[i] = p
        o = m.pt_head[p]
        while o >= 0:
            c = camera_of[m.kp_keyframe[o]]
            if c >= 0:
                obs_camera[n] = c
                obs_point[n] = i
                obs_keypoint[n] = o
                n += 1
            o = m.kp_next[o]
        i += 1
    return (
        cameras[:n_cam].copy(),
        points,
        obs_camera[:n].copy(),
        obs_point[:n].copy(),
        obs_keypoint[:n].copy(),
    )
