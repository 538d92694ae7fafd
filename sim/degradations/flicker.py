"""Flicker: lamps that rise and fall with the mains, seen row by row."""

import numpy as np

from dslab.scenarios.segments import Flicker
from dslab.sim.degradations.base import Stage, drawn, one_of, uniform
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import decode, encode

FELT_MODULATION = 0.1


class FlickerDegradation(ImageDegradation[Flicker]):
    """Multiplies each row's light by that of the lamps at the row's own time.

    ``1 + modulation cos(2 pi rate t + phase)``; the middle row is read at the frame's stamp. The modulation
    is what the shutter leaves of the lamps' own: an exposure of whole periods would leave none.
    """

    kind = "flicker"
    stage = Stage.SENSOR
    measure_name = "flicker_modulation"
    sample = drawn(modulation=uniform(0.1, 1), rate_hz=one_of(100.0, 120.0), readout_s=uniform(0.005, 0.03))

    def prepare(self, segment: Flicker, camera: Intrinsics, streams: Streams) -> Filter:
        phase = streams("phase").uniform(0, 2 * np.pi)
        row_s = ((np.arange(camera.height_px) + 0.5) / camera.height_px - 0.5) * segment.readout_s

        def flicker(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            modulation = view.strength * segment.modulation
            if modulation == 0:
                return image, 0.0
            lamps = 1 + modulation * np.cos(
                2 * np.pi * segment.rate_hz * (view.stamp_s - segment.start_s + row_s) + phase
            )
            return encode(decode(image) * lamps.astype(np.float32)[:, None]), modulation

        return flicker

    def threshold(self, segment: Flicker) -> float:
        """A tenth, or the segment's own modulation if smaller."""
        return min(FELT_MODULATION, segment.modulation)
