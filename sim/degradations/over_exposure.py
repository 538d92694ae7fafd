"""Over-exposure: bright parts saturate."""

import numpy as np

from dslab.scenarios.segments import OverExposure
from dslab.sim.degradations.base import Stage, drawn, uniform
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import map_light

ONE_STOP = 1.0


class OverExposureDegradation(ImageDegradation[OverExposure]):
    """Doubles the exposure once per stop."""

    kind = "over_exposure"
    stage = Stage.SENSOR
    measure_name = "over_exposure_stops"
    sample = drawn(stops=uniform(0.5, 6))

    def prepare(self, segment: OverExposure, camera: Intrinsics, streams: Streams) -> Filter:
        def expose(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            stops = view.strength * segment.stops
            return map_light(image, lambda light: 2**stops * light), stops

        return expose

    def threshold(self, segment: OverExposure) -> float:
        """One stop, or the segment's own stops if fewer."""
        return min(ONE_STOP, segment.stops)
