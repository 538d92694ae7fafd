"""Descriptions of the distributions of families."""

import re
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

from dslab.scenarios.describe import describe_kind, label_and_unit, plain
from dslab.scenarios.distributions import (
    Choice,
    Distribution,
    LogUniform,
    Uniform,
    is_distribution,
    parse_distribution,
)
from dslab.scenarios.families import Family
from dslab.scenarios.spec import Scenario

_PART = re.compile(r"[^.\[\]]+")
# The step from a choice to one of its options, in a parameter's path.
_OPTION = re.compile(r"\.choice\[\d+\]")


def describe_parameters(family: Family) -> dict[str, str]:
    """Describe what is drawn, by field, over all members.

    Numbers give their whole range, choices all their options. Fields have no indices: ``segments.contrast``.
    """
    everyone = [family.member(member) for member in family.members] or [family]
    fields: dict[str, list[Distribution]] = {}
    for one in everyone:
        for place, drawn in one.parameters.items():
            fields.setdefault(_field(place), []).append(drawn)
    return {name: _all_words(drawn) for name, drawn in fields.items()}


def parameter_label(place: str, written: dict[str, Any]) -> str:
    """Label a parameter: ``segment 1, low texture: contrast``.

    Args:
        place: as in ``Family.parameters``.
        written: the family's fields, which give the kind of the parameter's parent.
    """
    kind, names = _written_kind(place, written), _PART.findall(place)
    options = [int(option) + 1 for name, option in pairwise(names) if name == "choice"]
    names = _steps(place)
    words = label_and_unit(names[-1])[0]
    if names[-1] in ("segments", "world") and options:
        words += f", option {options[-1]}"
    if len(names) == 1:
        return words
    holder = f"segment {int(names[1]) + 1}" if names[0] == "segments" else describe_kind(names[0])
    said = f", {describe_kind(kind)}" if isinstance(kind, str) and names[0] != "trajectory" else ""
    return f"{holder}{said}" + (f": {words}" if not words.isdigit() else "")


def describe_parameter(place: str, distribution: Distribution) -> str:
    """Describe a distribution with its unit, given by the last name of its place."""
    _, unit = label_and_unit(_last_name(place))
    if isinstance(distribution, Uniform):
        return f"uniform from {plain(distribution.low)} to {plain(distribution.high)}{unit}"
    if isinstance(distribution, LogUniform):
        return f"log-uniform from {plain(distribution.low)} to {plain(distribution.high)}{unit}"
    return _choice_words(distribution, unit)


def describe_distribution(
    place: str, distribution: Distribution, written: dict[str, Any], scenario: Scenario
) -> str:
    """Describe the value that a scenario drew; empty if its option was not drawn.

    Args:
        place: as in ``Family.parameters``.
        distribution: the parameter.
        written: the family's fields.
        scenario: as sampled.
    """
    value: Any = scenario.model_dump(mode="json")
    kind = None
    try:
        for part in _steps(place):
            kind = value.get("kind") if isinstance(value, dict) else None
            value = value[int(part)] if isinstance(value, list) else value[part]
    except (KeyError, IndexError):
        return ""
    if _OPTION.search(place) and not (_may_be(distribution, value) and _written_kind(place, written) == kind):
        return ""
    if isinstance(value, dict):
        return describe_kind(str(value.get("kind", "")))
    if isinstance(value, list):
        return (
            ", ".join(describe_kind(v["kind"]) if isinstance(v, dict) else plain(v) for v in value) or "none"
        )
    return plain(value) + label_and_unit(_last_name(place))[1]


def _steps(place: str) -> list[str]:
    """Names and indices that lead to a parameter in a scenario, without choices."""
    return _PART.findall(_OPTION.sub("", place))


def _field(place: str) -> str:
    return ".".join(step for step in _steps(place) if not step.isdigit())


def _last_name(place: str) -> str:
    return _field(place).rpartition(".")[2]


def _all_words(distributions: list[Distribution]) -> str:
    """Describe one field's distributions together."""
    said: dict[str, None] = {}
    numbers = [drawn for drawn in distributions if not isinstance(drawn, Choice)]
    if numbers:
        log = " (log)" if all(isinstance(drawn, LogUniform) for drawn in numbers) else ""
        said[f"{min(d.low for d in numbers):g} to {max(d.high for d in numbers):g}{log}"] = None
    choices = [drawn for drawn in distributions if isinstance(drawn, Choice)]
    options = [option for choice in choices for option in choice.options]
    if all(isinstance(option, int | float) for option in options):
        options.sort()
    said.update(dict.fromkeys(name for option in options for name in _option_names(option)))
    words = list(said) or [f"one of {max(len(choice.options) for choice in choices)}"]
    return " or ".join([", ".join(words[:-1]), words[-1]] if words[1:] else words)


def _option_names(option: Any) -> Iterator[str]:
    """Names of an option: a mapping's kind or preset, a list's parts.

    Numbers drawn in it are parameters of their own.
    """
    if is_distribution(option):
        drawn = parse_distribution(option)
        for inner in drawn.options if isinstance(drawn, Choice) else ():
            yield from _option_names(inner)
    elif isinstance(option, dict):
        named = option.get("kind", option.get("preset"))
        if isinstance(named, str):
            yield named
    elif isinstance(option, list):
        for part in option:
            yield from _option_names(part)
    else:
        yield f"{option:g}" if isinstance(option, float) else str(option)


def _may_be(distribution: Distribution, value: Any) -> bool:
    """Return True if a distribution can give a number."""
    if not isinstance(value, int | float):
        return False
    if isinstance(distribution, Choice):
        return value in distribution.options
    return distribution.low <= value <= distribution.high


def _written_kind(place: str, written: dict[str, Any]) -> Any:
    """The kind of a parameter's parent."""
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
        return describe_parameter("", inner) + unit
    if isinstance(option, dict):
        return describe_kind(str(option.get("kind", ", ".join(map(str, option)))))
    if isinstance(option, list):
        return " then ".join(_option_words(part, "", k) for k, part in enumerate(option, 1)) or "none"
    return plain(option) + unit
