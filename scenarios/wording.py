"""Families in words, for lists and pages."""

from collections.abc import Iterator
from typing import Any

from scenarios.distributions import Choice, Distribution, LogUniform, is_distribution, parse_distribution
from scenarios.families import Family


def members_in_words(family: Family) -> str:
    """How many members there are and which, a row of numbers by its ends; empty if there are none."""
    members = family.members
    if not members:
        return ""
    if all(member.isdigit() for member in members):
        return f"{len(members)}: {members[0]} to {members[-1]}"
    return f"{len(members)}: {', '.join(members)}"


def parameters_in_words(family: Family) -> dict[str, str]:
    """What is drawn, by field, over all members: the whole range of numbers and everything to choose from.

    Fields are named without indices: ``segments.contrast``.
    """
    everyone = [family.member(member) for member in family.members] or [family]
    fields: dict[str, list[Distribution]] = {}
    for one in everyone:
        for place, drawn in one.parameters.items():
            fields.setdefault(_field(place), []).append(drawn)
    return {name: _words(drawn) for name, drawn in fields.items()}


def _field(place: str) -> str:
    parts = [part.split("[")[0] for part in place.split(".")]
    return ".".join(part for part in parts if part != "choice")


def _words(distributions: list[Distribution]) -> str:
    """One field's distributions together."""
    said: dict[str, None] = {}
    numbers = [drawn for drawn in distributions if not isinstance(drawn, Choice)]
    if numbers:
        log = " (log)" if all(isinstance(drawn, LogUniform) for drawn in numbers) else ""
        said[f"{min(d.low for d in numbers):g} to {max(d.high for d in numbers):g}{log}"] = None
    choices = [drawn for drawn in distributions if isinstance(drawn, Choice)]
    options = [option for choice in choices for option in choice.options]
    if all(isinstance(option, int | float) for option in options):
        options.sort()
    said.update(dict.fromkeys(name for option in options for name in _names(option)))
    words = list(said) or [f"one of {max(len(choice.options) for choice in choices)}"]
    return " or ".join([", ".join(words[:-1]), words[-1]] if words[1:] else words)


def _names(option: Any) -> Iterator[str]:
    """What an option of a choice is called: a mapping by its kind or preset, a list by its parts.

    Numbers that are drawn in it are told as parameters of their own.
    """
    if is_distribution(option):
        drawn = parse_distribution(option)
        for inner in drawn.options if isinstance(drawn, Choice) else ():
            yield from _names(inner)
    elif isinstance(option, dict):
        named = option.get("kind", option.get("preset"))
        if isinstance(named, str):
            yield named
    elif isinstance(option, list):
        for part in option:
            yield from _names(part)
    else:
        yield f"{option:g}" if isinstance(option, float) else str(option)
