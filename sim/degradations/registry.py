"""Degradations by kind.

Segments that lie over one another act in a fixed order, in whichever they are declared: by ``Stage`` (motion,
world, shutter, timing; then on the light's way from the surfaces to the file), within a stage by the order of
the list below, and segments of one kind by their start.
"""

from collections.abc import Iterable
from typing import Any, TypeVar

from dslab.scenarios.extensions import note_extension
from dslab.scenarios.kinds import kind_of
from dslab.scenarios.segments import SEGMENT_KINDS, ImageSegment, SegmentBase
from dslab.sim.degradations.base import Degradation, Stage
from dslab.sim.degradations.cracked_lens import CrackedLensDegradation
from dslab.sim.degradations.encoding import BandwidthLossDegradation, JpegDegradation
from dslab.sim.degradations.focus import DefocusDegradation, ShallowFocusDegradation
from dslab.sim.degradations.fog import FogDegradation
from dslab.sim.degradations.image import ImageDegradation
from dslab.sim.degradations.lens_dirt import LensDirtDegradation
from dslab.sim.degradations.lens_flare import LensFlareDegradation
from dslab.sim.degradations.light import (
    AutoExposureLagDegradation,
    CoveredLensDegradation,
    DayToNightDegradation,
    FlickerDegradation,
    OverExposureDegradation,
    VignettingDegradation,
)
from dslab.sim.degradations.low_light import LowLightDegradation
from dslab.sim.degradations.moving_objects import MovingObjectsDegradation
from dslab.sim.degradations.rain import RainDegradation
from dslab.sim.degradations.rolling_shutter import RollingShutterDegradation
from dslab.sim.degradations.rotation import FastRotationDegradation, PureRotationDegradation
from dslab.sim.degradations.texture import LowTextureDegradation, RepeatedTextureDegradation
from dslab.sim.degradations.timing import FrameDropsDegradation, MotionBlurDegradation, TimeJitterDegradation

_ALL: tuple[Degradation[Any] | ImageDegradation[Any], ...] = (
    # A stop delays what follows on the path; a swing keeps its own time.
    PureRotationDegradation(),
    FastRotationDegradation(),
    LowTextureDegradation(),
    RepeatedTextureDegradation(),
    MotionBlurDegradation(),
    FrameDropsDegradation(),
    TimeJitterDegradation(),
    FogDegradation(),
    MovingObjectsDegradation(),
    RollingShutterDegradation(),
    RainDegradation(),
    ShallowFocusDegradation(),
    LensFlareDegradation(),
    DefocusDegradation(),
    LensDirtDegradation(),
    CrackedLensDegradation(),
    VignettingDegradation(),
    CoveredLensDegradation(),
    FlickerDegradation(),
    DayToNightDegradation(),
    LowLightDegradation(),
    OverExposureDegradation(),
    AutoExposureLagDegradation(),
    JpegDegradation(),
    BandwidthLossDegradation(),
)

IMAGE_KINDS: dict[str, ImageDegradation[Any]] = {d.kind: d for d in _ALL if isinstance(d, ImageDegradation)}
"""The kinds that act on images."""

FRAME_PLAN_KINDS: dict[str, Degradation[Any]] = {
    d.kind: d for d in _ALL if not isinstance(d, ImageDegradation)
}
"""The kinds that act before a frame is rendered, or on which frames there are."""

DEGRADATIONS: dict[str, Degradation[Any] | ImageDegradation[Any]] = {d.kind: d for d in _ALL}
"""Every kind."""

_SegmentT = TypeVar("_SegmentT", bound=SegmentBase)


def in_order_of_action(segments: Iterable[_SegmentT]) -> list[_SegmentT]:
    """The segments in the order in which they act."""
    ranks = {kind: rank for rank, kind in enumerate(DEGRADATIONS)}

    def place(segment: _SegmentT) -> tuple[int, int, float]:
        kind = str(getattr(segment, "kind", ""))
        return DEGRADATIONS[kind].stage, ranks[kind], segment.start_s

    return sorted(segments, key=place)


def register_degradation(
    model: type[SegmentBase], degradation: Degradation[Any] | ImageDegradation[Any]
) -> None:
    """Add a kind of degradation, to be named as ``segments: [{kind: ...}]`` in scenarios.

    Within its stage it acts after the kinds that are there.

    Args:
        model: its fields in a scenario, with ``kind: Literal["name"]``: a subclass of
            ``scenarios.ImageSegment`` for one that acts on images, else of ``scenarios.SegmentBase``.
        degradation: an ``ImageDegradation``, or a ``Degradation`` that changes the frame plan.

    Raises:
        ValueError: model and degradation do not go together, the kind is taken, or an attribute is missing.
    """
    lacking = [name for name in ("kind", "stage", "measure_name") if not hasattr(degradation, name)]
    if lacking:
        raise ValueError(f"{type(degradation).__name__} has no {lacking[0]}")
    acts_on_images = isinstance(degradation, ImageDegradation)
    if acts_on_images != issubclass(model, ImageSegment):
        raise ValueError(f"{model.__name__}: a degradation of images and an ImageSegment go together")
    if acts_on_images != (degradation.stage >= Stage.SCENE):
        raise ValueError(f"{degradation.kind}: stage {degradation.stage.name} is not one of its family's")
    if kind_of(model) != degradation.kind:
        raise ValueError(f"the model is of kind {kind_of(model)!r}, the degradation of {degradation.kind!r}")
    kind = SEGMENT_KINDS.add(model)
    DEGRADATIONS[kind] = degradation
    if isinstance(degradation, ImageDegradation):
        IMAGE_KINDS[kind] = degradation
    else:
        FRAME_PLAN_KINDS[kind] = degradation
    note_extension(f"degradation: {kind}", degradation)
