"""Every kind of degradation: a new one is one file and one line here."""

from typing import Any

from sim.degradations.auto_exposure_lag import AutoExposureLagDegradation
from sim.degradations.base import Degradation
from sim.degradations.covered_lens import CoveredLensDegradation
from sim.degradations.defocus import DefocusDegradation
from sim.degradations.fast_rotation import FastRotationDegradation
from sim.degradations.fog import FogDegradation
from sim.degradations.frame_drops import FrameDropsDegradation
from sim.degradations.image import ImageDegradation
from sim.degradations.jpeg import JpegDegradation
from sim.degradations.lens_dirt import LensDirtDegradation
from sim.degradations.low_light import LowLightDegradation
from sim.degradations.low_texture import LowTextureDegradation
from sim.degradations.motion_blur import MotionBlurDegradation
from sim.degradations.moving_objects import MovingObjectsDegradation
from sim.degradations.over_exposure import OverExposureDegradation
from sim.degradations.pure_rotation import PureRotationDegradation
from sim.degradations.repeated_texture import RepeatedTextureDegradation
from sim.degradations.rolling_shutter import RollingShutterDegradation
from sim.degradations.time_jitter import TimeJitterDegradation

_ALL: tuple[Degradation[Any] | ImageDegradation[Any], ...] = (
    FastRotationDegradation(),
    PureRotationDegradation(),
    LowTextureDegradation(),
    RepeatedTextureDegradation(),
    MotionBlurDegradation(),
    FrameDropsDegradation(),
    TimeJitterDegradation(),
    FogDegradation(),
    MovingObjectsDegradation(),
    RollingShutterDegradation(),
    DefocusDegradation(),
    LensDirtDegradation(),
    CoveredLensDegradation(),
    LowLightDegradation(),
    OverExposureDegradation(),
    AutoExposureLagDegradation(),
    JpegDegradation(),
)

IMAGE_KINDS: dict[str, ImageDegradation[Any]] = {d.kind: d for d in _ALL if isinstance(d, ImageDegradation)}
"""The kinds that act on images."""

SHOOT_KINDS: dict[str, Degradation[Any]] = {d.kind: d for d in _ALL if not isinstance(d, ImageDegradation)}
"""The kinds that act before a frame is rendered, or on which frames there are."""

DEGRADATIONS: dict[str, Degradation[Any] | ImageDegradation[Any]] = {d.kind: d for d in _ALL}
"""Every kind."""
