"""Day to night: daylight goes, and the camera amplifies what is left."""

import numpy as np

from dslab.scenarios.segments import DayToNight
from dslab.sim.degradations.base import Stage, drawn, log_uniform, uniform
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import decode, encode

ONE_STOP = 1.0
_BEAM_DEG = 18.0  # standard deviation of the lamp's beam
_FULL_WELL_E, _READ_NOISE_E = 10000.0, 5.0
_LAMP = log_uniform(0.002, 0.1)


class DayToNightDegradation(ImageDegradation[DayToNight]):
    """Scales daylight, adds a lamp's beam, counts electrons and amplifies them.

    The camera amplifies as much as the daylight has lost, up to its gain; from then on it gets dark. Shot
    noise is approximated as normal.
    """

    kind = "day_to_night"
    stage = Stage.SENSOR
    measure_name = "night_stops"
    sample = drawn(stops=uniform(2, 14), lamp=lambda rng: rng.integers(2) * _LAMP(rng))

    def prepare(self, segment: DayToNight, camera: Intrinsics, streams: Streams) -> Filter:
        beam = _beam(camera)

        def darken(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            stops = view.strength * segment.stops
            if stops == 0:
                return image, 0.0
            daylight = 2.0**-stops
            gain = min(segment.gain, 1 / daylight)
            # The lamp is switched on as daylight goes.
            lit = np.float32(daylight) + np.float32(segment.lamp * (1 - daylight)) * beam
            electrons = decode(image) * lit * np.float32(_FULL_WELL_E)
            noise = streams(view.frame).standard_normal(image.shape, np.float32)
            electrons += np.sqrt(electrons + np.float32(_READ_NOISE_E**2)) * noise
            return encode(electrons * np.float32(gain / _FULL_WELL_E)), stops

        return darken

    def threshold(self, segment: DayToNight) -> float:
        """One stop, or the segment's own stops if fewer."""
        return min(ONE_STOP, segment.stops)


def _beam(camera: Intrinsics) -> np.ndarray:
    """(H, W) float32 light of a lamp on the camera, 1 in the middle of its beam."""
    x = (np.arange(camera.width_px) - camera.cx) / camera.fx
    y = (np.arange(camera.height_px) - camera.cy) / camera.fy
    off_axis = np.arctan(np.hypot(x, y[:, None])) / np.radians(_BEAM_DEG)
    return np.exp(-(off_axis**2) / 2).astype(np.float32)
