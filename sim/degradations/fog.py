"""Fog: the farther a surface, the more of its light is lost, and the more airlight is in its place."""

from typing import ClassVar

import cv2
import numpy as np

from scenarios.segments import Fog
from sim.camera import Intrinsics
from sim.degradations.base import Stage
from sim.degradations.exposure import srgb_to_linear
from sim.degradations.image import Filter, ImageDegradation, Streams, View
from sim.degradations.tone import decode, encode

HALF_THE_LIGHT = 0.5
_VERY_FAR_M = 1e4


class FogDegradation(ImageDegradation[Fog]):
    """Light ``J`` at distance ``d`` becomes ``J t + A (1 - t)`` with ``t = exp(-extinction d)``.

    Pixels without depth are taken as very far. Source: Koschmieder's law.
    """

    kind: ClassVar[str] = "fog"
    stage: ClassVar[Stage] = Stage.SCENE
    measure_name: ClassVar[str] = "fog_veil"
    needs_depth: ClassVar[bool] = True

    def sample(self, rng: np.random.Generator) -> dict[str, float | str]:
        """Extinction, uniform in its logarithm."""
        return {"extinction_per_m": float(np.exp(rng.uniform(np.log(0.05), np.log(5))))}

    def prepare(self, segment: Fog, camera: Intrinsics, streams: Streams) -> Filter:
        """See ``ImageDegradation``."""
        airlight = float(srgb_to_linear(np.array(segment.airlight_level / 255)))
        stretch = _ray_lengths(camera)

        def fog(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            extinction = view.strength * segment.extinction_per_m
            if extinction == 0:
                return image, 0.0
            if view.depth_m is None:
                raise ValueError("fog needs depth")
            distance_m = np.where(view.depth_m > 0, view.depth_m, np.float32(_VERY_FAR_M)) * stretch
            passing = cv2.exp(np.float32(-extinction) * distance_m)
            light = (decode(image) - np.float32(airlight)) * passing + np.float32(airlight)
            return encode(light), 1 - float(cv2.mean(passing)[0])

        return fog

    def threshold(self, segment: Fog) -> float:
        """Half of what is seen is fog."""
        return HALF_THE_LIGHT


def _ray_lengths(camera: Intrinsics) -> np.ndarray:
    """(H, W) float32 distance from the camera per depth along the optical axis."""
    x = (np.arange(camera.width_px) - camera.cx) / camera.fx
    y = (np.arange(camera.height_px) - camera.cy) / camera.fy
    return np.sqrt(1 + x**2 + y[:, None] ** 2).astype(np.float32)
