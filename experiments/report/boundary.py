"""The answer of a boundary search: one line, boundary.json and boundary.png."""

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
from dslab.experiments.report.conditions import axis_label, describe_label
from dslab.experiments.report.plots.boundary import draw_boundary
from dslab.experiments.report.plots.draw import rendered
from dslab.experiments.report.plots.style import WIDE_IN, settings
from dslab.experiments.runs.files import to_json
from dslab.experiments.statistics.boundary import CONFIDENCE, Boundary
from dslab.scenarios.describe import describe_field, label_and_unit, measured
from dslab.sim.io.folders import write_file

JSON_FILE, PICTURE_FILE = "boundary.json", "boundary.png"
FORMAT = 1
_POINTS = 121


def write_boundary(plan: BoundaryPlan, folder: Path) -> dict[str, Any]:
    """Write boundary.json and boundary.png of a search into its folder.

    Returns:
        What is in boundary.json.

    Raises:
        InputError: the folder is not that of the search, or cannot be written.
    """
    found = boundary_content(BoundarySchedule(plan, read_rows(folder)[1]))
    with settings():
        figure = draw_boundary(found, WIDE_IN)
        png = rendered("boundary", found["answer"], figure).png
    text = to_json(found, 1) + "\n"
    write_file(folder / JSON_FILE, partial(Path.write_text, data=text, encoding="utf-8"))
    write_file(folder / PICTURE_FILE, partial(Path.write_bytes, data=png))
    return found


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
        "system": plan.system,
        "of": plan.of,
        "failure": FAILURES[plan.of],
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
    of = f"{describe_label(plan.kind)}, {base}: {who}{plan.of} failure"
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
