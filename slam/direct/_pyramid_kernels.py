"""Kernels of image pyramids."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def halved(image):
    """(H // 2, W // 2) float32 means of 2x2 pixels."""
    height, width = image.shape[0] // 2, image.shape[1] // 2
    half = np.empty((height, width), np.float32)
    for y in range(height):
        above, below = image[2 * y], image[2 * y + 1]
        for x in range(width):
            half[y, x] = np.float32(0.25) * (
                (above[2 * x] + above[2 * x + 1]) + (below[2 * x] + below[2 * x + 1])
            )
    return half


@njit(cache=True, nogil=True)
def with_gradients(image):
    """(H, W, 3) float32 intensity and central differences; NaN on the border, where there are none."""
    height, width = image.shape
    out = np.empty((height, width, 3), np.float32)
    half = np.float32(0.5)
    for y in range(height):
        inside = 0 < y < height - 1
        for x in range(width):
            out[y, x, 0] = image[y, x]
            if inside and 0 < x < width - 1:
                out[y, x, 1] = half * (image[y, x + 1] - image[y, x - 1])
                out[y, x, 2] = half * (image[y + 1, x] - image[y - 1, x])
            else:
                out[y, x, 1] = out[y, x, 2] = np.nan
    return out
