"""Auto-exposure lag: the exposure follows a jump of the light late."""

from typing import ClassVar

import numpy as np

from dslab.scenarios.segments import AutoExposureLag
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.degradations.tone import map_light
from dslab.sim.sensors.camera import Intrinsics

FELT_STOPS = 0.5


class AutoExposureLagDegradation(ImageDegradation[AutoExposureLag]):
    """Exposure error that starts with the jump's stops and decays exponentially."""

    kind: ClassVar[str] = "auto_exposure_lag"
    stage: ClassVar[Stage] = Stage.SENSOR
    measure_name: ClassVar[str] = "exposure_error_stops"

    def sample(self, rng: np.random.Generator) -> dict[str, float | str]:
        """Jump, brighter or darker, and time constant."""
        stops = float(rng.uniform(1, 7)) * float(rng.choice([-1, 1]))
        return {"stops": stops, "time_constant_s": float(np.exp(rng.uniform(np.log(0.1), np.log(1.5))))}

    def prepare(self, segment: AutoExposureLag, camera: Intrinsics, streams: Streams) -> Filter:
        """See ``ImageDegradation``."""

        def lag(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            since_s = max(0.0, view.stamp_s - segment.start_s)
            stops = view.strength * segment.stops * float(np.exp(-since_s / segment.time_constant_s))
            return map_light(image, lambda light: 2**stops * light), abs(stops)

        return lag

    def threshold(self, segment: AutoExposureLag) -> float:
        """Half a stop, or half of a smaller jump."""
        return min(FELT_STOPS, abs(segment.stops) / 2)
