"""Kernels of the selection of points.

They follow the public code of the authors of "Direct Sparse Odometry" step by step.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def squared_gradients(level):
    """(H, W) float32 squared gradient of a level of a pyramid; 0 where it is unknown."""
    height, width = level.shape[0], level.shape[1]
    out = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            square = level[y, x, 1] * level[y, x, 1] + level[y, x, 2] * level[y, x, 2]
            out[y, x] = square if square > 0.0 else 0.0  # where it is NaN too
    return out


@njit(cache=True, nogil=True)
def thresholds(squares, region, beyond):
    """(rows, columns) float32 gradient that stands out in each region: its median plus ``beyond``, and the
    mean of this over the regions around; squared.
    """
    height, width = squares.shape
    rows, columns = max(1, height // region), max(1, width // region)
    raw = np.empty((rows, columns), np.float64)
    for r in range(rows):
        for c in range(columns):
            # The last regions take what is left over.
            bottom = height if r == rows - 1 else (r + 1) * region
            right = width if c == columns - 1 else (c + 1) * region
            raw[r, c] = _median_gradient(squares, r * region, bottom, c * region, right) + beyond
    out = np.empty((rows, columns), np.float32)
    for r in range(rows):
        for c in range(columns):
            total, count = 0.0, 0
            for i in range(max(0, r - 1), min(rows, r + 2)):
                for j in range(max(0, c - 1), min(columns, c + 2)):
                    total += raw[i, j]
                    count += 1
            out[r, c] = (total / count) ** 2
    return out


@njit(cache=True, nogil=True)
def _median_gradient(squares, top, bottom, left, right):
    """Median gradient of a region, rounded down to whole steps of intensity."""
    counts = np.zeros(256, np.int64)
    for y in range(top, bottom):
        for x in range(left, right):
            counts[min(255, int(np.sqrt(squares[y, x])))] += 1
    half = (bottom - top) * (right - left) // 2
    seen = 0
    for step in range(256):
        seen += counts[step]
        if seen > half:
            return step
    return 255


@njit(cache=True, nogil=True)
def select_in_blocks(fine, middle, coarse, bounds, region, block, margin, coarser):
    """Per block the pixel of largest gradient that stands out; where there is none in four of them, the one
    of the middle level, and in sixteen, of the coarse level.

    Returns:
        (N, 2) int32 pixels of the finest level, (N,) int32 levels.
    """
    height, width = fine.shape
    rows, columns = bounds.shape
    column_of = np.minimum(np.arange(width) // region, columns - 1)
    across, down = (width + 4 * block - 1) // (4 * block), (height + 4 * block - 1) // (4 * block)
    xy = np.empty((16 * across * down, 2), np.int32)
    scale = np.empty(16 * across * down, np.int32)
    n = 0
    for large in range(across * down):
        y4, x4 = large // across * 4 * block, large % across * 4 * block
        best4, at4_x, at4_y, first = 0.0, -1, -1, n
        for medium in range(4):
            y2, x2 = y4 + medium // 2 * 2 * block, x4 + medium % 2 * 2 * block
            best2, at2_x, at2_y, before = 0.0, -1, -1, n
            for small in range(4):
                y1, x1 = y2 + small // 2 * block, x2 + small % 2 * block
                best1, at1_x, at1_y = 0.0, -1, -1
                for y in range(max(y1, margin), min(y1 + block, height - margin)):
                    row = min(y // region, rows - 1)
                    for x in range(max(x1, margin), min(x1 + block, width - margin)):
                        bound = bounds[row, column_of[x]]
                        if fine[y, x] > max(bound, best1):
                            best1, at1_x, at1_y = fine[y, x], x, y
                        if y // 2 < middle.shape[0] and x // 2 < middle.shape[1]:
                            bound *= coarser * coarser
                            if middle[y // 2, x // 2] > max(bound, best2):
                                best2, at2_x, at2_y = middle[y // 2, x // 2], x, y
                        if y // 4 < coarse.shape[0] and x // 4 < coarse.shape[1]:
                            bound *= coarser * coarser
                            if coarse[y // 4, x // 4] > max(bound, best4):
                                best4, at4_x, at4_y = coarse[y // 4, x // 4], x, y
                if at1_x >= 0:
                    xy[n, 0], xy[n, 1], scale[n] = at1_x, at1_y, 0
                    n += 1
            if n == before and at2_x >= 0:
                xy[n, 0], xy[n, 1], scale[n] = at2_x, at2_y, 1
                n += 1
        if n == first and at4_x >= 0:
            xy[n, 0], xy[n, 1], scale[n] = at4_x, at4_y, 2
            n += 1
    return xy[:n].copy(), scale[:n].copy()
