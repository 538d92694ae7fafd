"""Every kind of degradation: a new one is one file and one line here."""

from typing import Any

from sim.degradations.base import Degradation
from sim.degradations.fast_rotation import FastRotationDegradation
from sim.degradations.low_texture import LowTextureDegradation
from sim.degradations.motion_blur import MotionBlurDegradation

_ALL: tuple[Degradation[Any], ...] = (
    FastRotationDegradation(),
    LowTextureDegradation(),
    MotionBlurDegradation(),
)

DEGRADATIONS: dict[str, Degradation[Any]] = {degradation.kind: degradation for degradation in _ALL}
