"""Rain: streaks of near drops, haze of distant ones, drops on the glass."""

import cv2
import numpy as np

from dslab.scenarios.segments import Rain
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.degradations.raindrops import REACH_M, RainField, extinction_per_m
from dslab.sim.degradations.wet_glass import WetGlass
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import decode, encode

_VERY_FAR_M = 1e4
# Used without a known motion: a camera at rest that looks straight ahead.
_LEVEL = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


class RainDegradation(ImageDegradation[Rain]):
    """Replaces light of the scene by light of the rain.

    Falling drops are streaks whose length is their motion relative to the camera during the exposure; they
    are lighter than most of the scene, since a drop gathers light from a wide angle. Drops beyond ``REACH_M``
    act as haze. Drops on the glass show the scene small, upside down and out of focus.
    Source: Garg, Nayar, "Vision and rain", IJCV 2007.
    """

    kind = "rain"
    # After the shutter, which would smear it: streaks have their own exposure, the glass moves with the
    # camera.
    stage = Stage.READOUT
    measure_name = "rain_veil"

    def prepare(self, segment: Rain, camera: Intrinsics, streams: Streams) -> Filter:
        return _Rain(segment, camera, streams)

    def threshold(self, segment: Rain) -> float:
        """A fiftieth of the light comes from the rain."""
        return 0.02


class _Rain:
    """The drops of one segment, in the air and on the glass."""

    def __init__(self, segment: Rain, camera: Intrinsics, streams: Streams) -> None:
        self._segment, self._camera = segment, camera
        self._k = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        rate, heading = segment.rate_mmph, float(streams("wind").uniform(0, 2 * np.pi))
        wind_mps = segment.wind_mps * np.array([np.cos(heading), np.sin(heading)])
        self._field = RainField.drawn(rate, wind_mps, streams("air")) if rate > 0 else None
        times_s = (segment.start_s - segment.wet_s, segment.end_s)
        self._glass = (
            WetGlass.from_rain(camera, segment.glass_mm, rate, segment.wind_mps, times_s, streams("glass"))
            if rate > 0 and segment.glass_mm > 0
            else None
        )
        self._stretch = camera.ray_lengths()

    def __call__(self, image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
        rate_mmph = view.strength * self._segment.rate_mmph
        if self._field is None or rate_mmph == 0:
            return image, 0.0
        light = decode(image)
        passing = self._through_the_air(view, rate_mmph)
        gray = np.float32(_bright_half(light))
        light = gray + passing * (light - gray)
        if self._glass is not None:
            drops = self._glass.drops_px(self._camera, view.stamp_s, rate_mmph)
            cover, through = self._glass.rendered(light, drops, self._camera)
            light += cover * (through - light)
            passing *= 1 - cover
        return encode(light), 1 - float(cv2.mean(passing)[0])

    def _through_the_air(self, view: View, rate_mmph: float) -> np.ndarray:
        """(H, W) float32 share of the light that passes between the drops."""
        half_s = view.exposure_s / 2
        opening, closing = (
            view.motion.T_world_cam(view.stamp_s + d) if view.motion else _LEVEL for d in (-half_s, half_s)
        )
        depth_m = view.depth_m
        if depth_m is None:
            depth_m = np.zeros((self._camera.height_px, self._camera.width_px), np.float32)
        assert self._field is not None
        passing = self._field.passing(
            depth_m, self._k, opening, closing, view.stamp_s, view.exposure_s, rate_mmph
        )
        if view.depth_m is not None:
            distance_m = np.where(depth_m > 0, depth_m * self._stretch, np.float32(_VERY_FAR_M))
            beyond_m = np.maximum(distance_m - np.float32(REACH_M), 0)
            passing *= cv2.exp(np.float32(-extinction_per_m(rate_mmph)) * beyond_m)
        return passing


def _bright_half(light: np.ndarray) -> float:
    """Mean of the brighter half of the light, about what a drop gathers."""
    small = cv2.resize(light, (16, 12), interpolation=cv2.INTER_AREA)
    return float(small[small >= np.median(small)].mean())
