"""Over-exposure: bright parts saturate."""

from typing import ClassVar

import numpy as np

from dslab.scenarios.segments import OverExposure
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.degradations.tone import map_light
from dslab.sim.sensors.camera import Intrinsics

ONE_STOP = 1.0


class OverExposureDegradation(ImageDegradation[OverExposure]):
    """Doubles the exposure once per stop."""

    kind: ClassVar[str] = "over_exposure"
    stage: ClassVar[Stage] = Stage.SENSOR
    measure_name: ClassVar[str] = "over_exposure_stops"

    def sample(self, rng: np.random.Generator) -> dict[str, float | str]:
        """Stops, uniform."""
        return {"stops": float(rng.uniform(0.5, 6))}

    def prepare(self, segment: OverExposure, camera: Intrinsics, streams: Streams) -> Filter:
        """See ``ImageDegradation``."""

        def expose(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            stops = view.strength * segment.stops
            return map_light(image, lambda light: 2**stops * light), stops

        return expose

    def threshold(self, segment: OverExposure) -> float:
        """One stop, or the segment's own stops if fewer."""
        return min(ONE_STOP, segment.stops)
