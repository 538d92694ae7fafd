"""Kernels of motion blur."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def line_of_light(direction, places, size):
    """(size, size) float32 light that a moving point leaves, one unit at each of its places.

    Args:
        direction: (2,) right and down, of unit length.
        places: (n,) along it, px from the middle.
        size: odd.
    """
    middle = size // 2
    light = np.zeros((size, size), np.float32)
    for at in places:
        x, y = middle + at * direction[0], middle + at * direction[1]
        c, r = int(np.floor(x)), int(np.floor(y))
        right, down = x - c, y - r
        for i in range(r, r + 2):
            for j in range(c, c + 2):
                if 0 <= i < size and 0 <= j < size:
                    light[i, j] += (right if j > c else 1 - x + c) * (down if i > r else 1 - y + r)
    return light
