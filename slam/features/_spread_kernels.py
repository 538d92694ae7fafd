"""Even distribution of corners: the strongest of each leaf of a quadtree."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _quadrant(x, y, mid_x, mid_y):
    return 2 * (y >= mid_y) + (x >= mid_x)


@njit(cache=True, nogil=True)
def _partition(order, start, end, xs, ys, mid_x, mid_y, scratch, bounds):
    # Sorts order[start:end] by quadrant. bounds (5,) receives the start of each and the end of the last one.
    # Returns the number of quadrants with a corner. Loops, since array expressions take seconds to compile.
    counts = np.zeros(4, np.int64)
    for k in range(start, end):
        counts[_quadrant(xs[order[k]], ys[order[k]], mid_x, mid_y)] += 1
    place = np.empty(4, np.int64)
    bounds[0] = start
    for q in range(4):
        place[q] = bounds[q]
        bounds[q + 1] = bounds[q] + counts[q]
    for k in range(start, end):
        i = order[k]
        q = _quadrant(xs[i], ys[i], mid_x, mid_y)
        scratch[place[q]] = i
        place[q] += 1
    for k in range(start, end):
        order[k] = scratch[k]
    n_occupied = 0
    for q in range(4):
        n_occupied += counts[q] > 0
    return n_occupied


@njit(cache=True, nogil=True)
def _grow_tree(order, xs, ys, leaves, height, width):
    # A leaf is a row: start and end in order, then its box x0, y0, x1, y1. Returns the number of leaves.
    most = leaves.shape[0]
    scratch = np.empty(order.size, np.int32)
    bounds = np.empty(5, np.int64)
    leaves[0] = 0
    leaves[0, 1], leaves[0, 4], leaves[0, 5] = order.size, width, height
    n_leaves = 1
    progress = True
    while progress and n_leaves < most:
        progress = False
        keys = np.empty(n_leaves, np.int64)  # fullest first, oldest first among equals
        for leaf in range(n_leaves):
            keys[leaf] = np.int64(order.size - (leaves[leaf, 1] - leaves[leaf, 0])) * most + leaf
        keys.sort()
        for key in keys:
            leaf = key % most
            start, end, x0, y0, x1, y1 = leaves[leaf]
            if end - start < 2:
                break
            mid_x, mid_y = (x0 + x1 + 1) // 2, (y0 + y1 + 1) // 2
            n_children = _partition(order, start, end, xs, ys, mid_x, mid_y, scratch, bounds)
            if n_leaves + n_children - 1 > most:
                continue
            progress = True
            slot = leaf
            for q in range(4):
                if bounds[q + 1] == bounds[q]:
                    continue
                leaves[slot, 0], leaves[slot, 1] = bounds[q], bounds[q + 1]
                leaves[slot, 2], leaves[slot, 4] = (mid_x, x1) if q % 2 else (x0, mid_x)
                leaves[slot, 3], leaves[slot, 5] = (mid_y, y1) if q >= 2 else (y0, mid_y)
                if slot != leaf:
                    n_leaves += 1
                slot = n_leaves
    return n_leaves


@njit(cache=True, nogil=True)
def spread_corners(
    xs: np.ndarray, ys: np.ndarray, contrasts: np.ndarray, height: int, width: int, n_wanted: int
) -> np.ndarray:
    """Choose at most ``n_wanted`` corners: the strongest of each leaf of a quadtree.

    All leaves with several corners are split round by round, the fullest first, until there are enough. The
    tree also covers the border, which has no corners: leaves there have less usable area.

    Args:
        xs: (N,) int32 columns; no two corners share a pixel.
        ys: (N,) int32 rows.
        contrasts: (N,) uint8.
        height: rows of the level.
        width: columns of the level.
        n_wanted: most corners returned; up to two fewer if no leaf can be split without exceeding it.

    Returns:
        (M,) int32 indices into the corners; all of them if N <= n_wanted.

    Source: Mur-Artal et al., ORB-SLAM, T-RO 2015, for even corners; the quadtree is of its public code.
    """
    order = np.arange(0, xs.size, 1, np.int32)
    if xs.size <= n_wanted:
        return order
    if n_wanted <= 0:
        return order[:0]
    leaves = np.empty((n_wanted, 6), np.int32)
    n_leaves = _grow_tree(order, xs, ys, leaves, height, width)
    chosen = np.empty(n_leaves, np.int32)
    for leaf in range(n_leaves):
        best = order[leaves[leaf, 0]]
        for k in range(leaves[leaf, 0] + 1, leaves[leaf, 1]):
            i = order[k]
            if contrasts[i] > contrasts[best] or (contrasts[i] == contrasts[best] and i < best):
                best = i
        chosen[leaf] = best
    return chosen
