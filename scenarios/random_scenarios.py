"""Random scenarios: a small world and many overlapping degradations of every kind.

They are made to break programs: from harmless to fatal, back to back, overlapping, from the first frame on.
The worlds are those of the family ``small``; number and times of segments cannot be written in a family's
notation, so they are drawn here, from their own streams.
"""

from typing import Any

import numpy as np

from dslab.scenarios.distributions import Choice, is_distribution, parse_distribution
from dslab.scenarios.families import load_family
from dslab.scenarios.seeds import rng_for
from dslab.scenarios.spec import Scenario

FAMILY = "small"

# The motorway and the building take several times as long to build and to render as the rest.
_WEIGHTS = {"building": 0.4, "motorway": 0.25}
_MIN_SEGMENT_S = 0.1
_ALIASED_SHARE = 0.25
_AXIS = {"choice": ["yaw", "pitch", "roll"]}
_RAMP_SHARE = {"choice": [0.0, 0.2, 0.5]}

_IMAGE_SEVERITIES: dict[str, dict[str, Any]] = {
    "fog": {"extinction_per_m": {"log_uniform": [0.01, 5]}, "airlight_level": {"uniform": [100, 240]}},
    "moving_objects": {"share": {"uniform": [0.05, 0.95]}, "rate_degps": {"log_uniform": [2, 300]}},
    "rolling_shutter": {"readout_s": {"log_uniform": [0.002, 0.06]}},
    "defocus": {"diameter_px": {"log_uniform": [1, 30]}},
    "lens_dirt": {"share": {"uniform": [0.05, 0.95]}, "spot_deg": {"log_uniform": [2, 30]}},
    "rain": {"rate_mmph": {"log_uniform": [1, 200]}, "wet_s": {"uniform": [0, 60]}},
    "covered_lens": {"transmission": {"choice": [0.0, {"log_uniform": [0.01, 0.9]}]}},
    "low_light": {"illumination": {"log_uniform": [0.002, 1]}, "gain": {"log_uniform": [1, 50]}},
    "over_exposure": {"stops": {"uniform": [0, 8]}},
    "auto_exposure_lag": {"stops": {"uniform": [-6, 6]}, "time_constant_s": {"log_uniform": [0.05, 3]}},
    "jpeg": {"quality": {"uniform": [0, 60]}},
}
_SHOOT_SEVERITIES: dict[str, dict[str, Any]] = {
    "low_texture": {"contrast": {"choice": [0.0, {"log_uniform": [0.02, 0.8]}]}},
    "repeated_texture": {"share": {"uniform": [0.1, 1]}, "period_m": {"log_uniform": [0.1, 2]}},
    "motion_blur": {"exposure_s": {"log_uniform": [0.01, 0.25]}},
    "fast_rotation": {"rate_degps": {"log_uniform": [20, 600]}, "axis": _AXIS},
    "pure_rotation": {"angle_deg": {"log_uniform": [1, 180]}, "axis": _AXIS},
    "frame_drops": {"share": {"choice": [1.0, {"uniform": [0.1, 0.9]}]}},
    "time_jitter": {"sigma_s": {"log_uniform": [0.001, 0.2]}},
}
# Of one more lane, which half of the scenarios have.
_EXTRA_SEVERITIES: dict[str, dict[str, Any]] = {
    "shallow_focus": {"aperture_mm": {"log_uniform": [1, 100]}, "focus_m": {"log_uniform": [0.3, 10]}},
    "lens_flare": {"veil": {"log_uniform": [0.01, 5]}, "off_axis_deg": {"uniform": [0, 60]}},
    "cracked_lens": {"cracks": {"log_uniform": [1, 150]}, "bend_deg": {"uniform": [0, 3]}},
    "vignetting": {"stops": {"uniform": [0, 14]}},
    "flicker": {
        "modulation": {"uniform": [0, 1]},
        "readout_s": {"choice": [0.0, {"uniform": [0.005, 0.05]}]},
    },
    "day_to_night": {"stops": {"uniform": [0, 16]}, "lamp": {"choice": [0.0, {"log_uniform": [0.001, 0.2]}]}},
    "bandwidth_loss": {"share": {"uniform": [0, 1]}},
}
_EXTRA_SHARE = 0.5
_LANE_SEVERITIES = _SHOOT_SEVERITIES | _IMAGE_SEVERITIES
SEVERITIES = _LANE_SEVERITIES | _EXTRA_SEVERITIES
"""Distributions of the severity of every kind of degradation."""


def random_severity(kind: str, rng: np.random.Generator) -> dict[str, Any]:
    """Draw the severity of a kind that comes with the lab, from harmless to fatal."""
    return {name: _drawn(node, rng) for name, node in SEVERITIES[kind].items()}


def random_scenario(seed: int) -> Scenario:
    """Draw the scenario of a seed.

    Raises:
        InputError: the seed is negative.
    """
    family = load_family(FAMILY)
    rng = rng_for(seed, "random", "member")
    weights = [_WEIGHTS.get(member, 1.0) for member in family.members]
    member = family.members[Choice(family.members, tuple(weights)).draw(rng)]
    scenario = family.member(member).sample(seed)
    segments = random_segments(seed, scenario.duration_s)
    data = scenario.model_dump() | {"name": f"random-{member}", "segments": segments}
    rng = rng_for(seed, "random", "aliased")
    if rng.random() < _ALIASED_SHARE:
        things, scaled, places = rng.random(3).tolist()
        data["world"]["aliased"] = {"things": things, "scaled": scaled, "places": places}
    return Scenario.model_validate(data)


def random_segments(seed: int, duration_s: float) -> list[dict[str, Any]]:
    """Draw segments in one to four lanes, each a row of segments.

    A drawn kind that would overlap a segment of its own kind is left out.
    """
    rng = rng_for(seed, "random", "lanes")
    lanes = int(rng.integers(1, 4))
    # From back to back to sparse.
    gap_share, gap_s = rng.random(), 4.0 * rng.random()
    segments: list[dict[str, Any]] = []
    for lane in range(lanes):
        rng = rng_for(seed, "random", "lane", lane)
        _draw_lane(rng, _LANE_SEVERITIES, segments, duration_s, gap_share, gap_s)
    rng = rng_for(seed, "random", "later lane")
    if rng.random() < _EXTRA_SHARE:
        _draw_lane(rng, _EXTRA_SEVERITIES, segments, duration_s, gap_share, gap_s)
    return segments


def _draw_lane(
    rng: np.random.Generator,
    severities: dict[str, dict[str, Any]],
    segments: list[dict[str, Any]],
    duration_s: float,
    gap_share: float,
    gap_s: float,
) -> None:
    """Add a row of segments of some kinds."""
    at_s = 0.0 if rng.random() < 0.5 else gap_s * rng.random()
    while duration_s - at_s >= _MIN_SEGMENT_S:
        length_s = min(_MIN_SEGMENT_S * 30.0 ** rng.random(), duration_s - at_s)
        segment = _segment(rng, severities, at_s, length_s)
        if not any(_clash(segment, other) for other in segments):
            segments.append(segment)
        at_s = segment["start_s"] + segment["duration_s"]
        if rng.random() < gap_share:
            at_s += gap_s * rng.random()


def _segment(
    rng: np.random.Generator, severities: dict[str, dict[str, Any]], start_s: float, length_s: float
) -> dict[str, Any]:
    kind = list(severities)[int(rng.integers(len(severities)))]
    segment = {"kind": kind, "start_s": start_s, "duration_s": length_s}
    segment |= random_severity(kind, rng)
    if kind not in _SHOOT_SEVERITIES:
        segment["ramp_s"] = length_s * _drawn(_RAMP_SHARE, rng)
    return segment


def _drawn(node: Any, rng: np.random.Generator) -> Any:
    if not is_distribution(node):
        return node
    found = parse_distribution(node)
    drawn = found.draw(rng)
    return _drawn(found.options[int(drawn)], rng) if isinstance(found, Choice) else drawn


def _clash(one: dict[str, Any], other: dict[str, Any]) -> bool:
    before = one["start_s"] + one["duration_s"] <= other["start_s"]
    after = other["start_s"] + other["duration_s"] <= one["start_s"]
    return one["kind"] == other["kind"] and not before and not after
