"""What lens and sensor make of the light, the same in every frame: softness, tone curve, noise."""

from functools import lru_cache

import cv2
import numpy as np

from dslab.scenarios.seeds import rng_for
from dslab.scenarios.spec import Camera
from dslab.sim.link import Link, View

_MIDDLE_LEVEL = 128
_BANK_SIZE = 1 << 22


class Softness:
    """The image that reaches the sensor, of one that reaches the lens: a Gaussian blur."""

    def __init__(self, sigma_px: float) -> None:
        self._sigma_px = sigma_px

    def apply(self, image: np.ndarray, view: View) -> tuple[np.ndarray, View]:
        return cv2.GaussianBlur(image, (0, 0), self._sigma_px, borderType=cv2.BORDER_REFLECT_101), view


class ToneCurve:
    """Contrast about the middle grey level."""

    def __init__(self, contrast: float) -> None:
        levels = _MIDDLE_LEVEL * (np.arange(256) / _MIDDLE_LEVEL) ** contrast
        self._level_of = np.clip(np.rint(levels), 0, 255).astype(np.uint8)

    def apply(self, image: np.ndarray, view: View) -> tuple[np.ndarray, View]:
        return cv2.LUT(image, self._level_of), view


class SensorNoise:
    """Additive white Gaussian noise in gray levels, independent between frames.

    Drawing a normal number per pixel would cost more than rendering, so each frame takes a seeded piece of
    one seeded bank; two frames take the same piece only with a small probability.

    Args:
        shape: (H, W) of the frames.
        sigma: standard deviation, grey levels, at most 30.
        seed: root seed; the streams are ``("noise", ...)``.
        shot: further standard deviation at level 255, at most 30; that of a level grows with its root.
    """

    def __init__(self, shape: tuple[int, int], sigma: float, seed: int, shot: float = 0.0) -> None:
        self._shape, self._sigma, self._seed, self._shot = shape, sigma, seed, shot
        size = max(_BANK_SIZE, 2 * shape[0] * shape[1])
        if shot:
            variance = sigma**2 + shot**2 * np.arange(256) / 255
            self._sigma_of = np.sqrt(variance).astype(np.float32)
        if shot or sigma:
            self._bank = _bank(size, seed, None if shot else sigma)

    def apply(self, image: np.ndarray, view: View) -> tuple[np.ndarray, View]:
        return self.added(image, view.frame), view

    def added(self, image: np.ndarray, frame: int) -> np.ndarray:
        """The (H, W) uint8 image with the noise of one frame number."""
        if self._sigma == 0 and not self._shot:
            return image.copy()
        pixels = self._shape[0] * self._shape[1]
        start = int(rng_for(self._seed, "noise", frame).integers(len(self._bank) - pixels))
        piece = self._bank[start : start + pixels].reshape(self._shape)
        if self._shot:
            piece = piece * cv2.LUT(image, self._sigma_of)
        return cv2.add(image, piece, dtype=cv2.CV_8U)


# Sequences that share their noise follow each other.
@lru_cache(maxsize=1)
def _bank(size: int, seed: int, sigma: float | None) -> np.ndarray:
    """(size,) float32 normal numbers, or with a sigma int8 noise in whole grey levels; read only."""
    bank = rng_for(seed, "noise", "bank").standard_normal(size, np.float32)
    if sigma is not None:
        bank = np.clip(np.rint(sigma * bank), -127, 127).astype(np.int8)
    bank.flags.writeable = False
    return bank


def sensor_links(camera: Camera, seed: int) -> tuple[list[Link], list[Link]]:
    """Make the links of a scenario's camera before and after the segments on lens and sensor.

    Args:
        camera: of the scenario.
        seed: root seed of the noise.
    """
    soft: list[Link] = [Softness(camera.softness_px)] if camera.softness_px else []
    tone: list[Link] = [ToneCurve(camera.contrast)] if camera.contrast != 1 else []
    noise = SensorNoise((camera.height_px, camera.width_px), camera.noise_sigma, seed, camera.shot_noise)
    return soft, [*tone, noise]
