"""Kernels of the corners among the pixels of direct odometry."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def gradient_products(level, products):
    """Products of the image gradient; 0 where it or the intensity is unknown.

    Args:
        level: (H, W, 3) float32 intensity and gradient.
        products: (H, W, 3) float32 to write to: gx gx, gx gy, gy gy.
    """
    for y in range(level.shape[0]):
        for x in range(level.shape[1]):
            gx, gy = level[y, x, 1], level[y, x, 2]
            known = np.isfinite(level[y, x, 0]) and np.isfinite(gx) and np.isfinite(gy)
            gx, gy = (gx, gy) if known else (np.float32(0), np.float32(0))
            products[y, x, 0], products[y, x, 1], products[y, x, 2] = gx * gx, gx * gy, gy * gy


@njit(cache=True, nogil=True)
def lesser_eigenvalues(structure, lesser):
    """Smaller eigenvalue of each structure tensor.

    Args:
        structure: (H, W, 3) float32 tensors: xx, xy, yy.
        lesser: (H, W) float32 to write to.
    """
    half, quarter = np.float32(0.5), np.float32(0.25)
    for y in range(structure.shape[0]):
        for x in range(structure.shape[1]):
            a, b, c = structure[y, x, 0], structure[y, x, 1], structure[y, x, 2]
            lesser[y, x] = half * (a + c) - np.sqrt(quarter * ((a - c) * (a - c)) + b * b)


@njit(cache=True, nogil=True)
def peaks(strength, level, least, border, reach, window):
    """Pixels that are as strong as all about them, row by row.

    Args:
        strength: (H, W) float32.
        level: (H, W, 3) intensity and gradient.
        least: a peak is stronger.
        border: pixels along the border without peaks.
        reach: a peak is compared with this many pixels to each side.
        window: a peak has no unknown pixel within this many to each side.

    Returns:
        (N, 2) int32.
    """
    height, width = strength.shape
    xy = np.empty((height * width, 2), np.int32)  # of equal strength all are peaks
    n = 0
    border = max(border, reach, window)
    for y in range(border, height - border):
        for x in range(border, width - border):
            value = strength[y, x]
            if not value > least:
                continue
            is_peak = True
            for v in range(y - reach, y + reach + 1):
                for u in range(x - reach, x + reach + 1):
                    if strength[v, u] > value:
                        is_peak = False
                        break
                if not is_peak:
                    break
            if is_peak and _is_known(level, y - window, y + window, x - window, x + window):
                xy[n, 0], xy[n, 1] = x, y
                n += 1
    return xy[:n].copy()


@njit(cache=True, nogil=True)
def _is_known(level, top, bottom, left, right):
    """True if all pixels of a window have intensity and gradient."""
    for y in range(top, bottom + 1):
        for x in range(left, right + 1):
            for m in range(3):
                if not np.isfinite(level[y, x, m]):
                    return False
    return True
