"""Fading detail of recorded frames: low texture where the surfaces themselves cannot be changed."""

import math

import cv2
import numpy as np

from dslab.sim.sensors.camera import Intrinsics

DETAIL_DEG = 4.0
"""Standard deviation of the Gaussian whose mean is no detail, visual angle: features of every scale are."""
_TILE = 8
_DARK, _BRIGHT = 8, 247


def fade(light: np.ndarray, contrast: float, camera: Intrinsics) -> np.ndarray:
    """Multiply the contrast of detail: light relative to its local mean.

    The mean of every surface stays, and so does the shading over more than some degrees.

    Args:
        light: (H, W) float32, 0 to 1.
        contrast: share of the contrast that remains.
        camera: intrinsics of the frame.

    Returns:
        (H, W) float32.
    """
    if contrast == 1:
        return light
    width_px = math.tan(math.radians(DETAIL_DEG)) * camera.fx
    mean = cv2.GaussianBlur(light, (0, 0), width_px, borderType=cv2.BORDER_REFLECT_101)
    return mean + np.float32(contrast) * (light - mean)


def noise_level(gray: np.ndarray) -> float:
    """Standard deviation of the white noise of a frame, grey levels, from its quietest parts.

    Args:
        gray: (H, W) uint8.
    """
    height, width = (size // (2 * _TILE) * 2 * _TILE for size in gray.shape)
    even = gray[:height, :width].astype(np.float32)
    # A diagonal difference sees no shading and no upright or level edge.
    diagonal = (even[::2, ::2] - even[1::2, ::2] - even[::2, 1::2] + even[1::2, 1::2]) / 2
    tiles = diagonal.reshape(height // 2 // _TILE, _TILE, width // 2 // _TILE, _TILE)
    means = even.reshape(height // 2 // _TILE, 2 * _TILE, width // 2 // _TILE, 2 * _TILE).mean(axis=(1, 3))
    spread = np.sqrt((tiles**2).mean(axis=(1, 3)))[(means > _DARK) & (means < _BRIGHT)]
    return float(np.quantile(spread, 0.25)) if spread.size else 0.0
