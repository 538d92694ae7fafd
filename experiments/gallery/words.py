"""Scenarios in words: fields with their units, segments with their severity, distributions."""

import re
from itertools import pairwise
from typing import Any

from scenarios.distributions import (
    Choice,
    Distribution,
    LogUniform,
    Uniform,
    is_distribution,
    parse_distribution,
)
from scenarios.segments import SegmentBase
from scenarios.spec import Scenario

# Longest endings first: `max_accel_mps2` is no number of seconds.
_UNITS = {
    "_per_m": " /m",
    "_degps": " °/s",
    "_mps2": " m/s²",
    "_mps": " m/s",
    "_deg": "°",
    "_px": " px",
    "_hz": " Hz",
    "_e": " e⁻",
    "_m": " m",
    "_s": " s",
}
# The step from a choice to one of its options, in a parameter's place.
_PART = re.compile(r"[^.\[\]]+")
_OPTION = re.compile(r"\.choice\[\d+\]")
# Names that are units themselves.
_BARE_UNITS = {"stops": " stops", "fps": " frames/s"}


def field_words(name: str, value: Any) -> str:
    """A field of a scenario: ``exposure 0.25 s`` of ``exposure_s`` and 0.25."""
    label, unit = _label_and_unit(name)
    return f"{plain(value)}{unit}" if name in _BARE_UNITS else f"{label} {plain(value)}{unit}"


def kind_words(kind: str) -> str:
    """A kind of segment, world or carrier as one reads it."""
    return kind.replace("_", " ")


def plain(value: Any) -> str:
    """A value in four digits."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return f"{value:.0f}" if abs(value) >= 1e4 else f"{value:.4g}"
    return str(value).replace("_", " ")


def measured(value: float) -> str:
    """What has been measured, in three digits."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def severity_words(segment: SegmentBase) -> str:
    """How bad a segment is, in physical units."""
    return ", ".join(
        field_words(name, value)
        for name, value in segment.severity.items()
        if not (name == "ramp_s" and not value)
    )


def span_words(segment: SegmentBase) -> str:
    """When a segment is."""
    return f"{segment.start_s:.4g} to {segment.end_s:.4g} s"


def world_words(scenario: Scenario) -> str:
    """The world and its sizes."""
    return _with_fields(scenario.world.kind, scenario.world.model_dump(exclude={"kind"}))


def motion_words(scenario: Scenario) -> str:
    """The carrier and its limits; what is 0 is left out."""
    fields = scenario.trajectory.model_dump(exclude={"kind"})
    return _with_fields(scenario.trajectory.kind, {name: value for name, value in fields.items() if value})


def camera_words(scenario: Scenario) -> str:
    """The camera."""
    camera = scenario.camera
    parts = [
        f"{camera.width_px} × {camera.height_px} px",
        f"{camera.fps:g} frames/s",
        f"focal length {camera.fx_px:.4g} × {camera.fy_px:.4g} px",
        f"exposure {1000 * camera.exposure_s:.3g} ms",
        f"noise {camera.noise_sigma:.3g} grey levels",
    ]
    if camera.distortion.model != "none":
        parts.append(f"{camera.distortion.model} distortion")
    return f"{camera.preset}: {', '.join(parts)}" if camera.preset else ", ".join(parts)


def parameter_label(place: str, written: dict[str, Any]) -> str:
    """What is drawn at a parameter's place: ``segment 1, low texture: contrast``.

    Args:
        place: as in ``Family.parameters``.
        written: the family's fields, which tell the kind of what holds the parameter.
    """
    kind, names = _written_kind(place, written), _PART.findall(place)
    options = [int(option) + 1 for name, option in pairwise(names) if name == "choice"]
    names = _PART.findall(_OPTION.sub("", place))
    words = _label_and_unit(names[-1])[0]
    if names[-1] in ("segments", "world") and options:
        words += f", option {options[-1]}"
    if len(names) == 1:
        return words
    holder = f"segment {int(names[1]) + 1}" if names[0] == "segments" else kind_words(names[0])
    said = f", {kind_words(kind)}" if isinstance(kind, str) and names[0] != "trajectory" else ""
    return f"{holder}{said}" + (f": {words}" if not words.isdigit() else "")


def parameter_words(place: str, distribution: Distribution) -> str:
    """A distribution with its unit, which the last name of its place tells."""
    _, unit = _label_and_unit(_last_name(place))
    if isinstance(distribution, Uniform):
        return f"uniform from {plain(distribution.low)} to {plain(distribution.high)}{unit}"
    if isinstance(distribution, LogUniform):
        return f"log-uniform from {plain(distribution.low)} to {plain(distribution.high)}{unit}"
    return _choice_words(distribution, unit)


def drawn_words(place: str, distribution: Distribution, written: dict[str, Any], scenario: Scenario) -> str:
    """What a scenario drew for a parameter; empty where another option was drawn than the one it is in.

    Args:
        place: as in ``Family.parameters``.
        distribution: the parameter.
        written: the family's fields.
        scenario: as sampled.
    """
    value: Any = scenario.model_dump(mode="json")
    kind = None
    try:
        for part in _PART.findall(_OPTION.sub("", place)):
            kind = value.get("kind") if isinstance(value, dict) else None
            value = value[int(part)] if isinstance(value, list) else value[part]
    except (KeyError, IndexError):
        return ""
    if _OPTION.search(place) and not (_may_be(distribution, value) and _written_kind(place, written) == kind):
        return ""
    if isinstance(value, dict):
        return kind_words(str(value.get("kind", "")))
    if isinstance(value, list):
        return ", ".join(kind_words(v["kind"]) if isinstance(v, dict) else plain(v) for v in value) or "none"
    return plain(value) + _label_and_unit(_last_name(place))[1]


def _may_be(distribution: Distribution, value: Any) -> bool:
    """Whether a distribution gives a value; of what is no number nobody can tell."""
    if not isinstance(value, int | float):
        return False
    if isinstance(distribution, Choice):
        return value in distribution.options
    return distribution.low <= value <= distribution.high


def _written_kind(place: str, written: dict[str, Any]) -> Any:
    """The kind of what holds a parameter."""
    node: Any = written
    kind = None
    for part in _PART.findall(place):
        kind = node.get("kind") if isinstance(node, dict) else None
        node = node[int(part)] if isinstance(node, list) else node[part]
    return kind


def _choice_words(choice: Choice, unit: str) -> str:
    names = [_option_words(option, unit, number) for number, option in enumerate(choice.options, 1)]
    if len(set(choice.weights)) > 1:
        total = sum(choice.weights)
        names = [f"{name} ({100 * w / total:.3g} %)" for name, w in zip(names, choice.weights, strict=True)]
    return "one of: " + "; ".join(names)


def _option_words(option: Any, unit: str, number: int) -> str:
    if is_distribution(option):
        inner = parse_distribution(option)
        if isinstance(inner, Choice):
            return f"option {number}, one of {len(inner.options)}"
        return parameter_words("", inner) + unit
    if isinstance(option, dict):
        return kind_words(str(option.get("kind", ", ".join(map(str, option)))))
    if isinstance(option, list):
        return " then ".join(_option_words(part, "", k) for k, part in enumerate(option, 1)) or "none"
    return plain(option) + unit


def _with_fields(kind: str, fields: dict[str, Any]) -> str:
    return ", ".join([kind_words(kind), *(field_words(name, value) for name, value in fields.items())])


def _last_name(place: str) -> str:
    return _OPTION.sub("", place).rsplit(".", 1)[-1].split("[")[0]


def _label_and_unit(name: str) -> tuple[str, str]:
    for ending, unit in _UNITS.items():
        if name.endswith(ending):
            return name.removesuffix(ending).replace("_", " "), unit
    return name.replace("_", " "), _BARE_UNITS.get(name, "")
