"""The simulator: a scenario becomes frames with exact ground truth; folders of recorded frames are read too.

The names below are what this package promises; everything else may change at any time. They are imported
when first used: ``import sim`` loads no GL and compiles nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dslab.sim.degradations.base import Degradation, FramePlan, Stage
    from dslab.sim.degradations.image import Filter, ImageDegradation
    from dslab.sim.degradations.recorded_sequences import degrade_sequence as degrade
    from dslab.sim.degradations.registry import register_degradation
    from dslab.sim.io.forms import load_sequence, write_sequence
    from dslab.sim.link import View
    from dslab.sim.motion import register_motion
    from dslab.sim.motion.base import Motion
    from dslab.sim.motion.spline import PoseSpline
    from dslab.sim.sensors.camera import Intrinsics
    from dslab.sim.sequence import SegmentTruth, Sequence
    from dslab.sim.sequence_rendering import render_sequence as render
    from dslab.sim.worlds import register_world
    from dslab.sim.worlds.base import Route, Surface, WorldModel

_HOMES = {
    "Degradation": "dslab.sim.degradations.base",
    "Filter": "dslab.sim.degradations.image",
    "FramePlan": "dslab.sim.degradations.base",
    "ImageDegradation": "dslab.sim.degradations.image",
    "Intrinsics": "dslab.sim.sensors.camera",
    "Motion": "dslab.sim.motion.base",
    "PoseSpline": "dslab.sim.motion.spline",
    "Route": "dslab.sim.worlds.base",
    "SegmentTruth": "dslab.sim.sequence",
    "Sequence": "dslab.sim.sequence",
    "Stage": "dslab.sim.degradations.base",
    "Surface": "dslab.sim.worlds.base",
    "View": "dslab.sim.link",
    "WorldModel": "dslab.sim.worlds.base",
    "degrade": "dslab.sim.degradations.recorded_sequences:degrade_sequence",
    "load_sequence": "dslab.sim.io.forms",
    "register_degradation": "dslab.sim.degradations.registry",
    "register_motion": "dslab.sim.motion",
    "register_world": "dslab.sim.worlds",
    "render": "dslab.sim.sequence_rendering:render_sequence",
    "write_sequence": "dslab.sim.io.forms",
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
