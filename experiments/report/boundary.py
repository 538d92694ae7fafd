"""The answer of a boundary search: one line, boundary.json and boundary.png."""

from collections.abc import Callable
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from dslab.experiments.campaign.boundary_schedule import BoundarySchedule
from dslab.experiments.campaign.folder import read_rows
from dslab.experiments.eq1.boundary_plan import FAILURES, BoundaryPlan
from dslab.experiments.eq1.records import Outcome
from dslab.experiments.eq1.units import RECOVERING
from dslab.experiments.report.conditions import axis_label, describe_base, describe_label
from dslab.experiments.report.plots.boundary import draw_boundary
from dslab.experiments.report.plots.draw import rendered
from dslab.experiments.report.plots.style import WIDE_IN, settings
from dslab.experiments.runs.files import to_json
from dslab.experiments.statistics.boundary import CONFIDENCE, Boundary
from dslab.scenarios.describe import describe_field, label_and_unit, measured
from dslab.sim.io.folders import write_file

JSON_FILE, PICTURE_FILE = "boundary.json", "boundary.png"
FORMAT = 2
_POINTS = 121
_MEASURED_TRIALS = 3
"""Trials of which some frames are rendered to measure what the dose is in the images."""


def write_boundary(
    plan: BoundaryPlan, folder: Path, progress: Callable[[int, int], None] = lambda done, total: None
) -> dict[str, Any]:
    """Write boundary.json and boundary.png of a search into its folder.

    Args:
        plan: of the search.
        folder: with its trials.
        progress: called with the numbers of trials in which the dose is measured, done and to do.

    Returns:
        What is in boundary.json.

    Raises:
        InputError: the folder is not that of the search, or cannot be written.
    """
    found = boundary_content(BoundarySchedule(plan, read_rows(folder)[1]))
    found["measured"] = None if found["dose"] is None else _measured(plan, found["dose"], progress)
    with settings():
        figure = draw_boundary(found, WIDE_IN, searched_text(found))
        png = rendered("boundary", found["answer"], figure).png
    text = to_json(found, 1) + "\n"
    write_file(folder / JSON_FILE, partial(Path.write_text, data=text, encoding="utf-8"))
    write_file(folder / PICTURE_FILE, partial(Path.write_bytes, data=png))
    return found


def searched_text(found: dict[str, Any]) -> list[str]:
    """What was searched, a line each: world, motion and camera, and what the dose is in the images."""
    lines = [f"{part}: {found['searched'][part]}" for part in ("world", "motion", "camera")]
    if of := found["measured"]:
        label, unit = label_and_unit(of["name"])
        at = f"{label} at {describe_field(of['field'], of['dose'])}"
        lines.append(f"{at}: {measured(of['value'])}{unit} (nearest of the doses searched)")
    return lines


def _measured(plan: BoundaryPlan, dose: float, progress: Callable[[int, int], None]) -> dict[str, Any]:
    """What the dose nearest to the answer measures in the images, by its kind's own measure."""
    from dslab.sim.stress_check import stress_measure

    near = min(range(len(plan.axis.doses)), key=lambda i: abs(plan.strengths[i] - plan.axis.strength(dose)))
    values, name = [], ""
    for trial in range(_MEASURED_TRIALS):
        progress(trial, _MEASURED_TRIALS)
        name, value = stress_measure(plan.spec.unit(plan.dose_cells[near], trial).scenario)
        values.append(value)
    about = {"field": plan.axis.field, "dose": plan.axis.doses[near], "trials": _MEASURED_TRIALS}
    return {"name": name, "value": float(np.median(values)), **about}


def boundary_content(schedule: BoundarySchedule) -> dict[str, Any]:
    """The figures of a search, of the trials so far.

    Returns:
        ``answer`` in words; ``status``, one of ``reached``, ``not_reached`` (even by the strongest dose) and
        ``exceeded`` (even by the weakest); ``dose`` with the ends ``low`` and ``high`` of its interval, the
        lower number first, null where the doses do not bound it; the trials, whose ``dose`` is null without
        stress and where it did not act; the curve of the failure.
    """
    plan, weights = schedule.plan, schedule.posterior()
    found = schedule.grid.boundary(weights, plan.level)
    status = status_of(found, plan)
    ends = [_dose_within(plan, u) for u in (found.low, found.high)]
    low, high = ends if plan.axis.rises else ends[::-1]
    records = schedule.records()
    places, failed = schedule.outcomes(plan.shams)
    return {
        "format": FORMAT,
        "answer": answer_text(found, plan),
        "status": status,
        "kind": plan.kind,
        "world": plan.spec.unit(plan.sham_cell, 0).scenario.world.kind,
        "base": next(iter(plan.spec.bases)),
        "searched": describe_base(plan.spec, plan.sham_cell),
        "system": plan.system,
        "of": plan.of,
        "failure": FAILURES[plan.of],
        "failure_name": plan.failure,
        "column": plan.column,
        "level": plan.level,
        "field": plan.axis.field,
        "axis": axis_label(plan.axis.field),
        "stronger": "more" if plan.axis.rises else "less",
        "weakest": plan.axis.weakest,
        "strongest": plan.axis.strongest,
        "dose": _dose_within(plan, found.median) if status == "reached" else None,
        "low": low,
        "high": high,
        "confidence": CONFIDENCE,
        "ceiling_too_low": found.unreachable,
        "sham": {"trials": len(places), "failures": sum(failed), "rate": found.sham_rate},
        "trials": [_trial(plan, record) for record in records],
        "void": sum(r["outcome"] == Outcome.VOID for r in records),
        "unexposed": sum(r["exposed"] is False for r in records),
        "errors": sum(r["outcome"] == Outcome.INFRASTRUCTURE_ERROR for r in records),
        "curve": _curve(schedule),
        "root_seed": plan.spec.root_seed,
        "codes": sorted({r["code"] for r in records if r["code"]}),
    }


def status_of(found: Boundary, plan: BoundaryPlan) -> str:
    """Where the boundary lies: within the doses, beyond all, or before all."""
    if found.median > plan.strengths[-1]:
        return "not_reached"
    return "exceeded" if found.median < plan.strengths[0] else "reached"


def answer_text(found: Boundary, plan: BoundaryPlan) -> str:
    """The answer in one line."""
    base, axis = next(iter(plan.spec.bases)), plan.axis
    who = "" if plan.spec.systems[0] in RECOVERING else f"{plan.system}, "
    of = f"{describe_label(plan.kind)}, {base}: {who}{plan.failure}"
    ends = [_dose_within(plan, u) for u in (found.low, found.high)]
    status = status_of(found, plan)
    if status == "reached":
        label, unit = label_and_unit(axis.field)
        ordered = ends if axis.rises else ends[::-1]
        between = ", ".join("unbounded" if end is None else measured(end) for end in ordered)
        dose = measured(axis.dose(found.median))
        label = "" if label == unit.strip() else f"{label} "
        return f"{of} reaches {plan.level:g} at {label}{dose}{unit} [{between}]"
    if status == "exceeded":
        weakest = describe_field(axis.field, axis.weakest)
        return f"{of} exceeds {plan.level:g} even at the weakest dose, {weakest}"
    strongest = describe_field(axis.field, axis.strongest)
    if found.unreachable > 0.5:
        return f"{of} does not reach {plan.level:g} at any dose up to {strongest}: its ceiling is lower"
    return f"{of} does not reach {plan.level:g} up to {strongest}"


def _dose_within(plan: BoundaryPlan, strength: float) -> float | None:
    """The dose of a strength; None outside the doses of the search."""
    within = isfinite(strength) and plan.strengths[0] <= strength <= plan.strengths[-1]
    return plan.axis.dose(strength) if within else None


def _trial(plan: BoundaryPlan, record: Any) -> dict[str, Any]:
    without = record["cell"] == plan.sham_cell or record["exposed"] is False
    outcome = record[plan.column]
    return {name: record[name] for name in ("unit_id", "cell", "index")} | {
        "dose": None if without else record["severity"],
        "failed": None if outcome is None else bool(outcome),
    }


def _curve(schedule: BoundarySchedule) -> dict[str, list[float]]:
    """Median and interval of the probability of failure over the doses, the weakest first."""
    plan = schedule.plan
    strengths = np.linspace(plan.strengths[0], plan.strengths[-1], _POINTS)
    median, low, high = schedule.grid.curve(schedule.posterior(), strengths)
    doses = [plan.axis.dose(u) for u in strengths]
    return {"dose": doses, "probability": median.tolist(), "low": low.tolist(), "high": high.tolist()}
