"""What lens and sensor make of the light, the same in every frame: softness, tone curve, noise."""

import cv2
import numpy as np

from dslab.scenarios.spec import Camera
from dslab.sim.sensors.noise import SensorNoise

_MIDDLE_LEVEL = 128


class Sensor:
    """Softness, tone curve and noise of a scenario's camera.

    Args:
        camera: of the scenario.
        seed: root seed of the noise.
    """

    def __init__(self, camera: Camera, seed: int) -> None:
        size = (camera.height_px, camera.width_px)
        self._noise = SensorNoise(size, camera.noise_sigma, seed, camera.shot_noise)
        self._softness_px = camera.softness_px
        levels = _MIDDLE_LEVEL * (np.arange(256) / _MIDDLE_LEVEL) ** camera.contrast
        tone = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
        self._tone = tone if camera.contrast != 1 else None

    def soften(self, image: np.ndarray) -> np.ndarray:
        """The (H, W) uint8 image that reaches the sensor, of one that reaches the lens."""
        if not self._softness_px:
            return image
        return cv2.GaussianBlur(image, (0, 0), self._softness_px, borderType=cv2.BORDER_REFLECT_101)

    def develop(self, image: np.ndarray, frame: int) -> np.ndarray:
        """The (H, W) uint8 image that the camera gives, of one on its sensor, by the frame's number."""
        if self._tone is not None:
            image = cv2.LUT(image, self._tone)
        return self._noise.apply(image, frame)
