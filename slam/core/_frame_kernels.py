"""What is asked of every frame: its keypoints by grid cell, its motion, its depth."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def sort_into_cells(xy, view):
    """Sort keypoints by grid cell with a counting sort.

    Args:
        xy: (N, 2) float64 undistorted keypoints, px.
        view: ViewGeometry.

    Returns:
        order (N,) int64, cell_start (cols * rows + 1,) int32.
    """
    n = len(xy)
    cells = np.empty(n, np.int32)
    cell_start = np.zeros(view.cols * view.rows + 1, np.int32)
    for i in range(n):
        col = min(max(int((xy[i, 0] - view.x_min) / view.cell), 0), view.cols - 1)
        row = min(max(int((xy[i, 1] - view.y_min) / view.cell), 0), view.rows - 1)
        cells[i] = row * view.cols + col
        cell_start[cells[i] + 1] += 1
    for c in range(view.cols * view.rows):
        cell_start[c + 1] += cell_start[c]
    fill = cell_start.copy()
    order = np.empty(n, np.int64)
    for i in range(n):
        order[fill[cells[i]]] = i
        fill[cells[i]] += 1
    return order, cell_start


@njit(cache=True, nogil=True)
def motion_between(T_before, T_after):
    """Translation and rotation vector (6,) of a small motion from one pose (4, 4) to another."""
    R, motion = np.zeros((3, 3)), np.empty(6)
    for r in range(3):
        motion[r] = T_after[r, 3]
        for c in range(3):
            for k in range(3):
                R[r, c] += T_after[r, k] * T_before[c, k]
            motion[r] -= R[r, c] * T_before[c, 3]
    motion[3], motion[4], motion[5] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    sine = 0.5 * np.sqrt(motion[3] ** 2 + motion[4] ** 2 + motion[5] ** 2)
    angle = np.arctan2(sine, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0))
    motion[3:] *= 0.5 * angle / sine if sine > 1e-9 else 0.5
    return motion


@njit(cache=True, nogil=True)
def median_depth(points, T_cam_map):
    """Median depth of points (N, 3) from a pose (4, 4), map units; NaN without any."""
    if len(points) == 0:
        return np.nan
    depth = np.empty(len(points))
    for i in range(len(points)):
        depth[i] = T_cam_map[2, 3]
        for k in range(3):
            depth[i] += T_cam_map[2, k] * points[i, k]
    return np.median(depth)
