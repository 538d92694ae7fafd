"""Compositing of rendered parts into frames; GL gives the lowest row first."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def put_nearer(rgb, part_zbuffer, gray, zbuffer):
    """Write the pixels of a part that are nearer than the frame so far.

    Args:
        rgb: (H, W, 3) uint8 colours of the part, all grey, the lowest row first.
        part_zbuffer: (H, W) float32 reversed depth of the part, 0 for nothing, the lowest row first.
        gray: (H, W) uint8 frame so far, the highest row first, written.
        zbuffer: (H, W) float32 reversed depth so far, the highest row first, written.
    """
    height, width = gray.shape
    for row in range(height):
        from_row = height - 1 - row
        for column in range(width):
            z = part_zbuffer[from_row, column]
            if z > zbuffer[row, column]:
                zbuffer[row, column] = z
                gray[row, column] = rgb[from_row, column, 0]


@njit(cache=True, nogil=True, error_model="numpy")
def metric_depth(zbuffer, bias, offset_m):
    """(H, W) float32 metres along the optical axis of a reversed depth buffer.

    Args:
        zbuffer: (H, W) float32, 1 on the near plane; where it is 0, so is the depth.
        bias: float32, see ``offset_m``.
        offset_m: float32; depth is ``offset_m / (zbuffer + bias)``.
    """
    height, width = zbuffer.shape
    depth_m = np.empty_like(zbuffer)
    for row in range(height):
        for column in range(width):
            z = zbuffer[row, column]
            depth_m[row, column] = offset_m / (z + bias) if z != 0 else np.float32(0)
    return depth_m
