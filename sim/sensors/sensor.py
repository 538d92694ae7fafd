"""What lens and sensor make of the light, the same in every frame: softness, tone curve, noise."""

import cv2
import numpy as np

from dslab.scenarios.spec import Camera
from dslab.sim.link import Link, View
from dslab.sim.sensors.noise import SensorNoise

_MIDDLE_LEVEL = 128


class Softness:
    """The image that reaches the sensor, of one that reaches the lens: a Gaussian blur."""

    def __init__(self, sigma_px: float) -> None:
        self._sigma_px = sigma_px

    def apply(self, image: np.ndarray, view: View) -> tuple[np.ndarray, View]:
        """See ``Link``."""
        return cv2.GaussianBlur(image, (0, 0), self._sigma_px, borderType=cv2.BORDER_REFLECT_101), view


class ToneCurve:
    """Contrast about the middle grey level."""

    def __init__(self, contrast: float) -> None:
        levels = _MIDDLE_LEVEL * (np.arange(256) / _MIDDLE_LEVEL) ** contrast
        self._level_of = np.clip(np.rint(levels), 0, 255).astype(np.uint8)

    def apply(self, image: np.ndarray, view: View) -> tuple[np.ndarray, View]:
        """See ``Link``."""
        return cv2.LUT(image, self._level_of), view


def sensor_links(camera: Camera, seed: int) -> tuple[list[Link], list[Link]]:
    """Make the links of a scenario's camera before and after the segments on lens and sensor.

    Args:
        camera: of the scenario.
        seed: root seed of the noise.
    """
    noise = SensorNoise((camera.height_px, camera.width_px), camera.noise_sigma, seed, camera.shot_noise)
    soft: list[Link] = [Softness(camera.softness_px)] if camera.softness_px else []
    tone: list[Link] = [ToneCurve(camera.contrast)] if camera.contrast != 1 else []
    return soft, [*tone, noise]
