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
    """(rows, columns) float32 median gradient of every region, to 1/8 of a grey level per px and 32 at most;
    what is left over belongs to the last ones.
    """
    height, width = squares.shape
    rows, columns = max(1, height // region), max(1, width // region)
    counts = np.zeros((rows, columns, 257), np.int32)
    for y in range(height):
        r = min(y // region, rows - 1)
        for x in range(width):
            counts[r, min(x // region, columns - 1), int(min(8.0 * np.sqrt(squares[y, x]), 256.0))] += 1
    out = np.empty((rows, columns), np.float32)
    for r in range(rows):
        for c in range(columns):
            half, step = counts[r, c].sum() // 2, 0
            seen = counts[r, c, 0]
            while seen <= half:
                step += 1
                seen += counts[r, c, step]
            out[r, c] = (step + 0.5) / 8.0 if step else 0.0
    return out


@njit(cache=True, nogil=True)
def strongest(squares, level, bounds, factor, block, margin, taken, xy):
    """Write the pixel of largest gradient of every block without a point, if it stands out.

    Args:
        squares: (H, W) squared gradients of a level.
        level: which one; its pixels are 2^level of the finest one's wide.
        bounds: (H0, W0) float32 squared gradient beyond which a pixel of the finest level stands out.
        factor: of the bounds on this level.
        block: side of a block, pixels of the finest level.
        margin: border without points, likewise.
        taken: (rows, columns) bool of the blocks: they have a point; changed.
        xy: (M, 2) int32 pixels of the finest level, written.

    Returns:
        Number of pixels chosen.
    """
    height, width = bounds.shape
    n = 0
    for r in range(taken.shape[0]):
        for c in range(taken.shape[1]):
            if taken[r, c]:
                continue
            top, left = r * block, c * block
            bottom, right = min(top + block, height), min(left + block, width)
            best, at_x, at_y = 0.0, -1, -1
            first_v, first_u = -(-max(top, margin) >> level), -(-max(left, margin) >> level)
            last_v = min((min(bottom, height - margin) - 1) >> level, squares.shape[0] - 1)
            last_u = min((min(right, width - margin) - 1) >> level, squares.shape[1] - 1)
            for v in range(first_v, last_v + 1):
                for u in range(first_u, last_u + 1):
                    if squares[v, u] > best and squares[v, u] > factor * bounds[v << level, u << level]:
                        best, at_x, at_y = squares[v, u], u << level, v << level
            if at_x >= 0:
                xy[n, 0], xy[n, 1] = at_x, at_y
                taken[r, c] = True
                n += 1
    return n
