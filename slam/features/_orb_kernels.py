"""Orientation and descriptor of ORB, for the corners of one pyramid level.

The hot loops index with unsigned integers: numba then omits its test for negative indices, and LLVM
vectorises.
"""

import math

import numpy as np
from numba import njit

from dslab.slam.features._brief_pattern import BRIEF_PAIRS

# Farthest pixel that a rotated pair reaches, hence the least distance of a keypoint to the image's edge.
BORDER_PX = round(float(np.hypot(*BRIEF_PAIRS.reshape(-1, 2).T.astype(float)).max()))

_RADIUS = 15
_WIDTH = 32  # of the patch: the disc's 31 columns and one of zero weight, to fill vector registers
# Half width of each row of the disc, from the centre down; symmetric about the diagonals too.
_HALF_WIDTHS = np.array([15, 15, 15, 15, 14, 14, 14, 13, 13, 12, 11, 10, 9, 8, 6, 3])
_V, _U = np.mgrid[-_RADIUS : _RADIUS + 1, -_RADIUS : _WIDTH - _RADIUS]
_INSIDE = np.abs(_U) <= _HALF_WIDTHS[np.abs(_V)]
_WEIGHT_X, _WEIGHT_Y = (_U * _INSIDE).astype(np.int32), (_V * _INSIDE).astype(np.int32)

_X1, _Y1, _X2, _Y2 = (np.ascontiguousarray(column, np.float32) for column in BRIEF_PAIRS.T)
# Adding and subtracting 1.5 * 2^23 rounds a small float32 to the nearest integer, ties to even.
_ROUNDER = np.float32(12582912.0)


@njit(cache=True, nogil=True)
def orientations(image: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """Orientation of each corner: direction to the intensity centroid of a disc of radius 15.

    Args:
        image: (H, W) uint8, contiguous.
        xs: (M,) int32 columns, at least ``BORDER_PX`` from the edge.
        ys: (M,) int32 rows.

    Returns:
        (M,) float32 degrees in [0, 360), from the x axis towards the y axis (clockwise as displayed).

    Source: Rublee et al., ORB, ICCV 2011, section 3.2.
    """
    height, width = image.shape
    flat = image.reshape(height * width)
    angles = np.empty(xs.size, np.float32)
    for k in range(xs.size):
        m_x = np.int32(0)
        m_y = np.int32(0)
        for v in range(2 * _RADIUS + 1):
            begin = (ys[k] + v - _RADIUS) * width + xs[k] - _RADIUS
            row = flat[begin : begin + _WIDTH]
            for u in range(np.uint64(_WIDTH)):
                m_x += np.int32(_WEIGHT_X[v, u]) * np.int32(row[u])
                m_y += np.int32(_WEIGHT_Y[v, u]) * np.int32(row[u])
        degrees = np.float32(math.degrees(math.atan2(m_y, m_x)))
        if degrees < 0:
            degrees += np.float32(360)
        angles[k] = degrees if degrees < 360 else np.float32(0)  # rounding may lift it to 360
    return angles


@njit(cache=True, nogil=True)
def descriptors(blurred: np.ndarray, xs: np.ndarray, ys: np.ndarray, angles_deg: np.ndarray) -> np.ndarray:
    """Rotated BRIEF descriptors, bit for bit those of OpenCV's ORB.

    Args:
        blurred: (H, W) uint8, contiguous: the level after its Gaussian blur.
        xs: (M,) int32 columns, at least ``BORDER_PX`` from the edge.
        ys: (M,) int32 rows.
        angles_deg: (M,) float32.

    Returns:
        (M, 4) uint64; bit k of word w is pair 64 w + k.
    """
    height, width = blurred.shape
    flat = blurred.reshape(height * width)
    out = np.empty((xs.size, 4), np.uint64)
    n_pairs = np.uint64(256)
    offsets_1 = np.empty(256, np.int32)
    offsets_2 = np.empty(256, np.int32)
    stride = np.int32(width)
    for k in range(xs.size):
        angle = angles_deg[k] * np.float32(math.pi / 180)
        cos = np.float32(math.cos(angle))
        sin = np.float32(math.sin(angle))
        centre = np.int32(ys[k] * width + xs[k])
        for i in range(n_pairs):
            x = (_X1[i] * cos - _Y1[i] * sin + _ROUNDER) - _ROUNDER
            y = (_X1[i] * sin + _Y1[i] * cos + _ROUNDER) - _ROUNDER
            offsets_1[i] = centre + np.int32(y) * stride + np.int32(x)
            x = (_X2[i] * cos - _Y2[i] * sin + _ROUNDER) - _ROUNDER
            y = (_X2[i] * sin + _Y2[i] * cos + _ROUNDER) - _ROUNDER
            offsets_2[i] = centre + np.int32(y) * stride + np.int32(x)
        for w in range(4):
            word = np.uint64(0)
            for b in range(64):
                i = 64 * w + b
                darker = flat[np.uint32(offsets_1[i])] < flat[np.uint32(offsets_2[i])]
                word |= np.uint64(darker) << np.uint64(b)
            out[k, w] = word
    return out
