"""Windowed matching of two whole frames, pyramid level by pyramid level."""

import numpy as np
from numba import njit

from dslab.slam.features._hamming import popcount64
from dslab.slam.matching.orientation import keep_common_turn
from dslab.slam.matching.window import FREE_BITS


@njit(cache=True, nogil=True)
def _on_level(level, octave, xy, descriptors, cell_start):
    """Keypoints of one pyramid level, in order: rows, pixels, descriptors, and their grid."""
    count = 0
    for i in range(len(octave)):
        count += octave[i] == level
    rows = np.empty(count, np.int32)
    level_xy = np.empty((count, 2), np.float64)
    level_descriptors = np.empty((count, 4), np.uint64)
    level_start = np.zeros(len(cell_start), np.int32)
    k = 0
    for cell in range(len(cell_start) - 1):
        for i in range(cell_start[cell], cell_start[cell + 1]):
            if octave[i] != level:
                continue
            rows[k] = i
            level_xy[k] = xy[i]
            level_descriptors[k] = descriptors[i]
            k += 1
        level_start[cell + 1] = k
    return rows, level_xy, level_descriptors, level_start


@njit(cache=True, nogil=True)
def _nearest_on_level(view, xy, descriptors, cell_start, u, v, radius, query, ratio):
    """Keypoint of one level within a window with the nearest descriptor: (position or -1, bits)."""
    best, second, found = 257, 257, -1
    if u + radius < view.x_min or v + radius < view.y_min:
        return found, best
    c0 = max(int((u - radius - view.x_min) / view.cell), 0)
    c1 = min(int((u + radius - view.x_min) / view.cell), view.cols - 1)
    r0 = max(int((v - radius - view.y_min) / view.cell), 0)
    r1 = min(int((v + radius - view.y_min) / view.cell), view.rows - 1)
    q0, q1, q2, q3 = query[0], query[1], query[2], query[3]
    for r in range(r0, r1 + 1):
        for i in range(
            np.uint64(cell_start[r * view.cols + c0]), np.uint64(cell_start[r * view.cols + c1 + 1])
        ):
            if abs(xy[i, 0] - u) > radius or abs(xy[i, 1] - v) > radius:
                continue
            d = popcount64(descriptors[i, 0] ^ q0) + popcount64(descriptors[i, 1] ^ q1)
            d += popcount64(descriptors[i, 2] ^ q2) + popcount64(descriptors[i, 3] ^ q3)
            if d < best:
                best, second, found = d, best, np.int64(i)
            elif d < second:
                second = d
    if second < 257 and best > ratio * second:
        return -1, 257
    return found, best


@njit(cache=True, nogil=True)
def match_for_initialization(xy_1, octave_1, angle_1, descriptors_1, around, view, xy_2, octave_2, angle_2,
                             descriptors_2, cell_start_2, radius, max_octave, ratio):  # fmt: skip
    """Match two frames one to one within windows, on fine pyramid levels only.

    Matches stay on their level. Windows are wide, so that levels are searched one by one: each has only a
    fraction of all keypoints.

    Args:
        xy_1, octave_1, angle_1, descriptors_1: the first frame.
        around: (N, 2) float64 window centre in the second frame for each of its keypoints, px.
        view: ViewGeometry.
        xy_2, octave_2, angle_2, descriptors_2, cell_start_2: the second frame.
        radius: half side of the window, px.
        max_octave: coarsest level used.
        ratio: largest ratio of best to second best distance.

    Returns:
        (N,) int32 row in the second frame, -1 for none; count.
    """
    n = len(octave_1)
    matched = np.full(n, -1, np.int32)
    turn = np.zeros(n, np.float64)
    for level in range(max_octave + 1):
        rows, xy, descriptors, cell_start = _on_level(level, octave_2, xy_2, descriptors_2, cell_start_2)
        owner = np.full(len(rows), -1, np.int32)
        owner_distance = np.full(len(rows), 257, np.int64)
        for j in range(n):
            if octave_1[j] != level:
                continue
            i, d = _nearest_on_level(
                view, xy, descriptors, cell_start, around[j, 0], around[j, 1], radius, descriptors_1[j], ratio
            )
            if i < 0 or d > FREE_BITS or d >= owner_distance[i]:
                continue
            if owner[i] >= 0:
                matched[owner[i]] = -1
            owner[i], owner_distance[i] = j, d
            matched[j] = rows[i]
            turn[j] = angle_1[j] - angle_2[rows[i]]
    return matched, keep_common_turn(matched, turn)
