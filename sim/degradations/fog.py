"""Fog and haze: airlight replaces the light of distant surfaces."""

import cv2
import numpy as np

from dslab.scenarios.segments import Fog
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import decode, encode, srgb_to_linear
from dslab.sim.worlds.base import Haze

_VERY_FAR_M = 1e4


class Scattering:
    """Light ``J`` at distance ``d`` becomes ``J t + A (1 - t)`` with ``t = exp(-extinction d)``.

    Pixels without depth are taken as very far. Source: Koschmieder's law.

    Args:
        camera: intrinsics of the images.
        airlight_level: gray level of ``A``, sRGB-encoded.
    """

    def __init__(self, camera: Intrinsics, airlight_level: float) -> None:
        self._airlight = np.float32(srgb_to_linear(np.array(airlight_level / 255)))
        self._stretch = camera.ray_lengths()

    def drawn(
        self, image: np.ndarray, depth_m: np.ndarray, extinction_per_m: float
    ) -> tuple[np.ndarray, float]:
        """Return the image seen through the air, and the mean share of airlight.

        Args:
            image: (H, W) uint8, left unchanged.
            depth_m: (H, W) float32 depth along the optical axis, 0 for none.
            extinction_per_m: share of the light lost per metre.
        """
        distance_m = np.where(depth_m > 0, depth_m, np.float32(_VERY_FAR_M)) * self._stretch
        passing = cv2.exp(np.float32(-extinction_per_m) * distance_m)
        light = (decode(image) - self._airlight) * passing + self._airlight
        return encode(light), 1 - float(cv2.mean(passing)[0])


class HazeLink:
    """The haze of a world, as a link of the imaging chain."""

    def __init__(self, camera: Intrinsics, haze: Haze) -> None:
        self._scattering, self._haze = Scattering(camera, haze.airlight_level), haze

    def apply(self, image: np.ndarray, view: View) -> tuple[np.ndarray, View]:
        assert view.depth_m is not None
        return self._scattering.drawn(image, view.depth_m, self._haze.extinction_per_m)[0], view


class FogDegradation(ImageDegradation[Fog]):
    """Fog that comes and goes; see ``Scattering``."""

    kind = "fog"
    stage = Stage.SCENE
    measure_name = "fog_veil"
    needs_depth = True
    is_drawn = False

    def prepare(self, segment: Fog, camera: Intrinsics, streams: Streams) -> Filter:
        scattering = Scattering(camera, segment.airlight_level)

        def fog(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            extinction = view.strength * segment.extinction_per_m
            if extinction == 0:
                return image, 0.0
            if view.depth_m is None:
                raise ValueError("fog needs depth")
            return scattering.drawn(image, view.depth_m, extinction)

        return fog

    def threshold(self, segment: Fog) -> float:
        """Half of the light is airlight."""
        return 0.5
