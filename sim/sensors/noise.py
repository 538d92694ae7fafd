"""Sensor noise from a precomputed bank."""

import cv2
import numpy as np

from scenarios.seeds import rng_for

_BANK_SIZE = 1 << 22


class SensorNoise:
    """Additive white Gaussian noise in gray levels, independent between frames.

    Drawing a normal number per pixel would cost more than rendering, so each frame takes a seeded piece of
    one seeded bank; two frames take the same piece only with a small probability.

    Args:
        shape: (H, W) of the frames.
        sigma: standard deviation, grey levels, at most 30.
        seed: root seed; the streams are ``("noise", ...)``.
    """

    def __init__(self, shape: tuple[int, int], sigma: float, seed: int) -> None:
        self._shape, self._sigma, self._seed = shape, sigma, seed
        size = max(_BANK_SIZE, 2 * shape[0] * shape[1])
        normals = rng_for(seed, "noise", "bank").standard_normal(size, np.float32)
        self._bank = np.clip(np.rint(sigma * normals), -127, 127).astype(np.int8)

    def apply(self, image: np.ndarray, frame: int) -> np.ndarray:
        """The (H, W) uint8 image with the noise of one frame index."""
        if self._sigma == 0:
            return image.copy()
        pixels = self._shape[0] * self._shape[1]
        start = int(rng_for(self._seed, "noise", frame).integers(len(self._bank) - pixels))
        piece = self._bank[start : start + pixels].reshape(self._shape)
        return cv2.add(image, piece, dtype=cv2.CV_8U)
