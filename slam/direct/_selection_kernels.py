"""Kernels of the selection of points."""

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
def region_medians(squares, region):
    """(rows, columns) float32 median gradient of every region; what is left over belongs to the last ones."""
    height, width = squares.shape
    rows, columns = max(1, height // region), max(1, width // region)
    out = np.empty((rows, columns), np.float32)
    for r in range(rows):
        for c in range(columns):
            bottom = height if r == rows - 1 else (r + 1) * region
            right = width if c == columns - 1 else (c + 1) * region
            out[r, c] = np.sqrt(np.median(squares[r * region : bottom, c * region : right]))
    return out


@njit(cache=True, nogil=True)
def strongest(squares, level, bounds, region, block, margin, taken, xy):
    """Write the pixel of largest gradient of every block without a point, if it stands out.

    Args:
        squares: (H, W) squared gradients of a level.
        level: which one; its pixels are 2^level of the finest one's wide.
        bounds: (rows, columns) gradient beyond which a pixel stands out, by regions of the finest level.
        region: side of these, pixels of the finest level.
        block: side of a block, likewise.
        margin: border without points, likewise.
        taken: (H0, W0) bool of the finest level; the pixels that are chosen become true.
        xy: (M, 2) int32 pixels of the finest level, written.

    Returns:
        Number of pixels chosen.
    """
    height, width = taken.shape
    rows, columns = bounds.shape
    n = 0
    for top in range(0, height, block):
        for left in range(0, width, block):
            bottom, right = min(top + block, height), min(left + block, width)
            if taken[top:bottom, left:right].any():
                continue
            best, at_x, at_y = 0.0, -1, -1
            for y in range(max(top, margin), min(bottom, height - margin)):
                for x in range(max(left, margin), min(right, width - margin)):
                    v, u = y >> level, x >> level
                    if v >= squares.shape[0] or u >= squares.shape[1]:
                        continue
                    bound = bounds[min(y // region, rows - 1), min(x // region, columns - 1)]
                    if squares[v, u] > max(bound * bound, best):
                        best, at_x, at_y = squares[v, u], x, y
            if at_x >= 0:
                xy[n, 0], xy[n, 1] = at_x, at_y
                taken[at_y, at_x] = True
                n += 1
    return n
