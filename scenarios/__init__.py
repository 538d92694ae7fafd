"""Scenarios: what happens in a sequence, as typed and validated data. Nothing is executed here.

The names below are what this package promises; everything else may change at any time. They are imported
when first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenarios.errors import InputError
    from scenarios.families import Family, family_names, load_family
    from scenarios.loading import dump_yaml
    from scenarios.loading import load_scenario as load
    from scenarios.schema import json_schema
    from scenarios.segment_text import parse_segment
    from scenarios.segments import ImageSegment, SegmentBase
    from scenarios.spec import Camera, Imu, Scenario, Trajectory
    from scenarios.worlds import Lamps, Outdoors, WorldBase

_HOMES = {
    "Camera": "scenarios.spec",
    "Family": "scenarios.families",
    "ImageSegment": "scenarios.segments",
    "Imu": "scenarios.spec",
    "InputError": "scenarios.errors",
    "Lamps": "scenarios.worlds",
    "Outdoors": "scenarios.worlds",
    "Scenario": "scenarios.spec",
    "SegmentBase": "scenarios.segments",
    "Trajectory": "scenarios.spec",
    "WorldBase": "scenarios.worlds",
    "dump_yaml": "scenarios.loading",
    "family_names": "scenarios.families",
    "json_schema": "scenarios.schema",
    "load": "scenarios.loading:load_scenario",
    "load_family": "scenarios.families",
    "parse_segment": "scenarios.segment_text",
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
