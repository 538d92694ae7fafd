"""Fog: airlight replaces the light of distant surfaces."""

from typing import ClassVar

import numpy as np

from dslab.scenarios.segments import Fog
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.degradations.scattering import Scattering
from dslab.sim.sensors.camera import Intrinsics

HALF_THE_LIGHT = 0.5


class FogDegradation(ImageDegradation[Fog]):
    """Fog that comes and goes; see ``Scattering``."""

    kind: ClassVar[str] = "fog"
    stage: ClassVar[Stage] = Stage.SCENE
    measure_name: ClassVar[str] = "fog_veil"
    needs_depth: ClassVar[bool] = True
    is_drawn: ClassVar[bool] = False

    def sample(self, rng: np.random.Generator) -> dict[str, float | str]:
        """Extinction, uniform in its logarithm."""
        return {"extinction_per_m": float(np.exp(rng.uniform(np.log(0.05), np.log(5))))}

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
