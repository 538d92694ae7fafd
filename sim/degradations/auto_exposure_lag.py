"""Auto-exposure lag: the exposure follows a jump of the light late."""

import numpy as np

from dslab.scenarios.segments import AutoExposureLag
from dslab.sim.degradations.base import Stage, drawn, log_uniform
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import map_light

FELT_STOPS = 0.5


class AutoExposureLagDegradation(ImageDegradation[AutoExposureLag]):
    """Exposure error that starts with the jump's stops and decays exponentially."""

    kind = "auto_exposure_lag"
    stage = Stage.SENSOR
    measure_name = "exposure_error_stops"
    sample = drawn(
        stops=lambda rng: rng.uniform(1, 7) * rng.choice([-1, 1]), time_constant_s=log_uniform(0.1, 1.5)
    )

    def prepare(self, segment: AutoExposureLag, camera: Intrinsics, streams: Streams) -> Filter:
        def lag(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            since_s = max(0.0, view.stamp_s - segment.start_s)
            stops = view.strength * segment.stops * float(np.exp(-since_s / segment.time_constant_s))
            return map_light(image, lambda light: 2**stops * light), abs(stops)

        return lag

    def threshold(self, segment: AutoExposureLag) -> float:
        """Half a stop, or half of a smaller jump."""
        return min(FELT_STOPS, abs(segment.stops) / 2)
