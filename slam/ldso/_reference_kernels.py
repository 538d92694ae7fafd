"""Kernels that spread the inverse depths of points over the levels of a keyframe's pyramid.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 3.1: points are projected and slightly
dilated. Ours: by the four pixels beside each, and coarser levels have weighted means.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def splat(uv, inverse_depth, weight, total, mass):
    """Add points to the pixels nearest to them.

    Args:
        uv: (N, 2) pixels of the finest level; those outside are left out.
        inverse_depth, weight: (N,).
        total, mass: (H, W) sums of weight times inverse depth, and of weight.
    """
    height, width = total.shape
    for i in range(uv.shape[0]):
        x, y = int(np.floor(uv[i, 0] + 0.5)), int(np.floor(uv[i, 1] + 0.5))
        if 0 <= x < width and 0 <= y < height:
            total[y, x] += weight[i] * inverse_depth[i]
            mass[y, x] += weight[i]


@njit(cache=True, nogil=True)
def halved_sums(fine):
    """(H // 2, W // 2) sums of 2x2 pixels."""
    height, width = fine.shape[0] // 2, fine.shape[1] // 2
    out = np.empty((height, width))
    for y in range(height):
        for x in range(width):
            out[y, x] = fine[2 * y, 2 * x] + fine[2 * y, 2 * x + 1]
            out[y, x] += fine[2 * y + 1, 2 * x] + fine[2 * y + 1, 2 * x + 1]
    return out


@njit(cache=True, nogil=True)
def gather(total, mass, level, margin, uv, inverse_depth, intensity):
    """Write the pixels that have a depth, those without taking the mean of the four beside them.

    Args:
        total, mass: (H, W) sums as of :func:`splat`, of this level.
        level: (H, W, 3) of the keyframe.
        margin: pixels along the border left out.
        uv, inverse_depth, intensity: (H W, 2), (H W,), (H W,) to write to.

    Returns:
        Number of pixels.
    """
    height, width = total.shape
    count = 0
    for y in range(margin, height - margin):
        for x in range(margin, width - margin):
            t, m = total[y, x], mass[y, x]
            if m <= 0.0:
                t = total[y, x - 1] + total[y, x + 1] + total[y - 1, x] + total[y + 1, x]
                m = mass[y, x - 1] + mass[y, x + 1] + mass[y - 1, x] + mass[y + 1, x]
            value = level[y, x, 0]
            if m > 0.0 and t > 0.0 and value >= 0.0:  # not NaN
                uv[count, 0], uv[count, 1] = x, y
                inverse_depth[count], intensity[count] = t / m, value
                count += 1
    return count
