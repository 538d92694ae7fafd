"""The simulator: a scenario becomes frames with exact ground truth; folders of recorded frames are read too.

The names below are what this package promises; everything else may change at any time. They are imported
when first used: ``import sim`` loads no GL and compiles nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sim.degradations.base import Degradation, FramePlan, Stage
    from sim.degradations.image import Filter, ImageDegradation, View
    from sim.degradations.recorded_sequences import degrade_sequence as degrade
    from sim.degradations.registry import register_degradation
    from sim.io.forms import load_sequence, write_sequence
    from sim.motion import register_motion
    from sim.motion.base import Motion
    from sim.motion.spline import PoseSpline
    from sim.sensors.camera import Intrinsics
    from sim.sequence import SegmentTruth, Sequence
    from sim.sequence_rendering import render_sequence as render
    from sim.worlds import register_world
    from sim.worlds.base import Route, Surface, WorldModel

_HOMES = {
    "Degradation": "sim.degradations.base",
    "Filter": "sim.degradations.image",
    "FramePlan": "sim.degradations.base",
    "ImageDegradation": "sim.degradations.image",
    "Intrinsics": "sim.sensors.camera",
    "Motion": "sim.motion.base",
    "PoseSpline": "sim.motion.spline",
    "Route": "sim.worlds.base",
    "SegmentTruth": "sim.sequence",
    "Sequence": "sim.sequence",
    "Stage": "sim.degradations.base",
    "Surface": "sim.worlds.base",
    "View": "sim.degradations.image",
    "WorldModel": "sim.worlds.base",
    "degrade": "sim.degradations.recorded_sequences:degrade_sequence",
    "load_sequence": "sim.io.forms",
    "register_degradation": "sim.degradations.registry",
    "register_motion": "sim.motion",
    "register_world": "sim.worlds",
    "render": "sim.sequence_rendering:render_sequence",
    "write_sequence": "sim.io.forms",
}

__all__ = [
    "Degradation",
    "Filter",
    "FramePlan",
    "ImageDegradation",
    "Intrinsics",
    "Motion",
    "PoseSpline",
    "Route",
    "SegmentTruth",
    "Sequence",
    "Stage",
    "Surface",
    "View",
    "WorldModel",
    "degrade",
    "load_sequence",
    "register_degradation",
    "register_motion",
    "register_world",
    "render",
    "write_sequence",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, original = _HOMES[name].partition(":")
    return getattr(import_module(module), original or name)


def __dir__() -> list[str]:
    return sorted(__all__)
