"""Even distribution of corners: the strongest in the cells of nested grids."""

import numpy as np
from numba import njit

_LEAST_CELL_PX = 4
"""Cells are no smaller: corners so near to each other show the same."""


@njit(cache=True, nogil=True)
def spread_corners(
    xs: np.ndarray, ys: np.ndarray, contrasts: np.ndarray, height: int, width: int, n_wanted: int
) -> np.ndarray:
    """Choose ``n_wanted`` corners, evenly over the image and the strong ones before the weak ones.

    Grids halve their cells from one to the next, the first is one cell. The strongest corner of a cell is the
    strongest in one of the cells that it is divided into, so that what a grid chooses, all finer ones choose
    too. Corners are taken grid by grid; of those that the last one adds, the strongest. So the choice hardly
    changes from image to image as long as the corners do not.

    Args:
        xs: (N,) int32 columns; no two corners share a pixel.
        ys: (N,) int32 rows.
        contrasts: (N,) uint8.
        height: rows of the level.
        width: columns of the level.
        n_wanted: corners returned.

    Returns:
        (M,) int32 increasing indices into the corners; all of them if N <= n_wanted.
    """
    n = xs.size
    if n <= n_wanted:
        return np.arange(0, n, 1, np.int32)
    taken, left = np.zeros(n, np.bool_), n_wanted
    columns, per_px = 1, 1.0 / max(height, width)
    while left > 0 and per_px * _LEAST_CELL_PX <= 1.0:
        strongest = np.full(columns * columns, -1, np.int32)
        for i in range(n):
            cell = int(ys[i] * per_px) * columns + int(xs[i] * per_px)
            j = strongest[cell]
            if j < 0 or contrasts[i] > contrasts[j]:
                strongest[cell] = i
        left -= _take(taken, strongest, contrasts, left)
        columns, per_px = 2 * columns, 2.0 * per_px
    _take(taken, np.arange(0, n, 1, np.int32), contrasts, left)
    return np.flatnonzero(taken).astype(np.int32)


@njit(cache=True, nogil=True)
def _take(taken, candidates, contrasts, most):
    """Take the candidates, -1 for none, that are not yet taken: the strongest ``most`` of them; how many."""
    count = np.zeros(256, np.int64)
    for i in candidates:
        if i >= 0 and not taken[i]:
            count[contrasts[i]] += 1
    # The least contrast of which there is room for some, and for how many.
    least, room = 256, most
    while least > 0 and room >= count[least - 1]:
        least -= 1
        room -= count[least]
    n = 0
    for i in candidates:
        if i < 0 or taken[i] or contrasts[i] < least - 1:
            continue
        if contrasts[i] == least - 1:
            if room == 0:
                continue
            room -= 1
        taken[i] = True
        n += 1
    return n
