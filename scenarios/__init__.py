"""Scenarios: what happens in a sequence, as typed and validated data. Nothing is executed here.

The names below are what this package promises; everything else may change at any time.
"""

from scenarios.errors import InputError
from scenarios.families import Family, family_names, load_family
from scenarios.loading import dump_yaml
from scenarios.loading import load_scenario as load
from scenarios.schema import json_schema
from scenarios.segment_text import parse_segment
from scenarios.segments import ImageSegment, SegmentBase
from scenarios.spec import Camera, Imu, Scenario, Trajectory
from scenarios.worlds import Lamps, Outdoors, WorldBase

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
