"""Scenarios: what happens in a sequence, as typed and validated data. Nothing is executed here.

The names below are what this package promises; everything else may change at any time. They are imported
when first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dslab.scenarios.errors import InputError
    from dslab.scenarios.families import Family, family_names, load_family
    from dslab.scenarios.loading import dump_yaml
    from dslab.scenarios.loading import load_scenario as load
    from dslab.scenarios.schema import json_schema
    from dslab.scenarios.segment_text import parse_segment
    from dslab.scenarios.segments import ImageSegment, SegmentBase
    from dslab.scenarios.spec import Camera, Imu, Scenario, Trajectory
    from dslab.scenarios.worlds import Lamps, Outdoors, WorldBase

_HOMES = {
    "Camera": "dslab.scenarios.spec",
    "Family": "dslab.scenarios.families",
    "ImageSegment": "dslab.scenarios.segments",
    "Imu": "dslab.scenarios.spec",
    "InputError": "dslab.scenarios.errors",
    "Lamps": "dslab.scenarios.worlds",
    "Outdoors": "dslab.scenarios.worlds",
    "Scenario": "dslab.scenarios.spec",
    "SegmentBase": "dslab.scenarios.segments",
    "Trajectory": "dslab.scenarios.spec",
    "WorldBase": "dslab.scenarios.worlds",
    "dump_yaml": "dslab.scenarios.loading",
    "family_names": "dslab.scenarios.families",
    "json_schema": "dslab.scenarios.schema",
    "load": "dslab.scenarios.loading:load_scenario",
    "load_family": "dslab.scenarios.families",
    "parse_segment": "dslab.scenarios.segment_text",
}

__all__ = [
    "Camera",
    "Family",
    "ImageSegment",
    "Imu",
    "InputError",
    "Lamps",
    "Outdoors",
    "Scenario",
    "SegmentBase",
    "Trajectory",
    "WorldBase",
    "dump_yaml",
    "family_names",
    "json_schema",
    "load",
    "load_family",
    "parse_segment",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, original = _HOMES[name].partition(":")
    return getattr(import_module(module), original or name)


def __dir__() -> list[str]:
    return sorted(__all__)
