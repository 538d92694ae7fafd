"""Inputs that differ in one dose only: the series of a comparison."""

from collections.abc import Mapping
from typing import Any

from dslab.experiments.comparison.dose_response import dose_response, dose_title
from dslab.experiments.comparison.identity import by_system
from dslab.experiments.comparison.left_runs import LeftRun

_FIGURES = ("declares", "breakages", "intact", "completeness", "ate_m")
_Field = tuple[int, str, str]
"""Place and kind of a segment, and a field of its severity."""


def dose_groups(groups: Mapping[str, list[LeftRun]]) -> list[dict[str, Any]]:
    """Find inputs of one name, source and seed that differ in one number of one segment of theirs.

    Args:
        groups: runs by input, of :func:`experiments.comparison.identity.by_input`.

    Returns:
        Per kind of segment and field the title of the ``axis`` and the ``points`` of the systems over all
        sequences that have such doses, as of ``dose_response``.
    """
    alike: dict[tuple, list[list[LeftRun]]] = {}
    for own in groups.values():
        of = own[0].summary
        alike.setdefault((own[0].sequence, of.get("source"), of.get("scenario_seed")), []).append(own)
    series: dict[tuple[str, str], list[tuple[str, float, LeftRun]]] = {}
    for place, inputs in enumerate(alike.values()):
        doses = [_doses(own[0]) for own in inputs]
        varied = [field for field in doses[0] if len({of.get(field) for of in doses}) > 1]
        if len(varied) == 1 and len({of.get(varied[0]) for of in doses} - {None}) == len(inputs):
            found = series.setdefault(varied[0][1:], [])
            for own, of in zip(inputs, doses, strict=True):
                found += [(str(place), of[varied[0]], run) for run in own]
    return [{"axis": dose_title(*about), "points": _points(found)} for about, found in series.items()]


def _doses(run: LeftRun) -> dict[_Field, float]:
    """Every number of the severities of a run's segments."""
    return {
        (place, segment["kind"], name): float(value)
        for place, segment in enumerate(run.summary["segments"])
        for name, value in segment["severity"].items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }


def _points(found: list[tuple[str, float, LeftRun]]) -> list[dict[str, Any]]:
    names = {id(run): name for name, own in by_system([run for *_, run in found]).items() for run in own}
    return dose_response(
        {"sequence": place, "dose": dose, "system": names[id(run)]}
        | {name: run.summary.get(name) for name in _FIGURES}
        for place, dose, run in found
    )
