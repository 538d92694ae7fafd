"""Covered lens: a cover withholds light, up to blank frames."""

import numpy as np

from dslab.scenarios.segments import CoveredLens
from dslab.sim.degradations.base import Stage, drawn, log_uniform
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import map_light

HALF_THE_LIGHT = 0.5


class CoveredLensDegradation(ImageDegradation[CoveredLens]):
    """Multiplies the light by the cover's transmission."""

    kind = "covered_lens"
    stage = Stage.LENS
    measure_name = "light_withheld"
    sample = drawn(transmission=log_uniform(0.0005, 0.5))

    def prepare(self, segment: CoveredLens, camera: Intrinsics, streams: Streams) -> Filter:
        def cover(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            withheld = view.strength * (1 - segment.transmission)
            return map_light(image, lambda light: (1 - withheld) * light), withheld

        return cover

    def threshold(self, segment: CoveredLens) -> float:
        """Half of the light, or all that the cover withholds, if that is less."""
        return min(HALF_THE_LIGHT, 1 - segment.transmission)
