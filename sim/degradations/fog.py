"""Fog: airlight replaces the light of distant surfaces."""

import numpy as np

from dslab.scenarios.segments import Fog
from dslab.sim.degradations.base import Stage, drawn, log_uniform
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.degradations.scattering import Scattering
from dslab.sim.sensors.camera import Intrinsics

HALF_THE_LIGHT = 0.5


class FogDegradation(ImageDegradation[Fog]):
    """Fog that comes and goes; see ``Scattering``."""

    kind = "fog"
    stage = Stage.SCENE
    measure_name = "fog_veil"
    sample = drawn(extinction_per_m=log_uniform(0.05, 5))
    needs_depth = True
    is_drawn = False

    def prepare(self, segment: Fog, camera: Intrinsics, streams: Streams) -> Filter:
        """See ``ImageDegradation``."""
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
        return HALF_THE_LIGHT
