"""Vignetting: less light towards the corners."""

import numpy as np

from dslab.scenarios.segments import Vignetting
from dslab.sim.degradations.base import Stage, drawn, uniform
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import decode, encode

ONE_STOP = 1.0


class VignettingDegradation(ImageDegradation[Vignetting]):
    """Halves the light once per stop; stops grow with the square of the distance from the optical axis."""

    kind = "vignetting"
    stage = Stage.LENS
    measure_name = "vignetting_stops"
    sample = drawn(stops=uniform(1, 12))

    def prepare(self, segment: Vignetting, camera: Intrinsics, streams: Streams) -> Filter:
        x, y = np.arange(camera.width_px) - camera.cx, np.arange(camera.height_px) - camera.cy
        squared = x**2 + y[:, None] ** 2
        share = (squared / squared.max()).astype(np.float32)

        def vignette(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            stops = view.strength * segment.stops
            if stops == 0:
                return image, 0.0
            return encode(decode(image) * np.exp2(np.float32(-stops) * share)), stops

        return vignette

    def threshold(self, segment: Vignetting) -> float:
        """One stop, or the segment's own stops if fewer."""
        return min(ONE_STOP, segment.stops)
