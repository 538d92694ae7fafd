"""Fast conversion between sRGB-encoded gray levels and linear light."""

from collections.abc import Callable

import cv2
import numpy as np
from numba import njit

_CODES = 16384


def srgb_to_linear(level: np.ndarray) -> np.ndarray:
    """Light, 0 to 1, of sRGB-encoded levels, 0 to 1. Source: IEC 61966-2-1."""
    return np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(light: np.ndarray) -> np.ndarray:
    """sRGB-encoded levels, 0 to 1, of light, 0 to 1. Source: IEC 61966-2-1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


DECODE = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
"""(256,) float32 light, 0 to 1, of each level."""
ENCODE = np.rint(255 * linear_to_srgb(np.arange(_CODES) / (_CODES - 1))).astype(np.uint8)
"""(16384,) uint8 level of light from 0 to 1."""


def decode(gray: np.ndarray) -> np.ndarray:
    """(H, W) float32 light, 0 to 1, of an (H, W) uint8 image."""
    return cv2.LUT(gray, DECODE)


def encode(light: np.ndarray) -> np.ndarray:
    """(H, W) uint8 image of (H, W) float32 light; saturates below 0 and above 1."""
    out = np.empty(light.shape, np.uint8)
    _encode(np.ascontiguousarray(light).ravel(), ENCODE, out.ravel())
    return out


def map_light(gray: np.ndarray, change: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """(H, W) uint8 image after a change of light that depends only on the level.

    Args:
        gray: (H, W) uint8.
        change: light to light, elementwise.
    """
    levels = 255 * linear_to_srgb(np.clip(change(DECODE.astype(float)), 0, 1))
    return cv2.LUT(gray, np.rint(levels).astype(np.uint8))


@njit(cache=True, nogil=True)
def _encode(light, table, out):
    top, half, zero = np.float32(len(table) - 1), np.float32(0.5), np.float32(0)
    for at in range(len(light)):
        out[at] = table[np.int32(min(max(light[at] * top, zero), top) + half)]
