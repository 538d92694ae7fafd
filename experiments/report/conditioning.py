"""Pose error against baseline, in words and as the marks of its plot."""

from typing import Any

import pandas as pd

from experiments.eq1.records import PAIR_GAPS, pair_column
from experiments.report.describe import ends, number, plural
from experiments.report.plain_data import as_data
from experiments.statistics.conditioning import QUANTITIES, lead_ins

QUANTITY_WORDS = {"rotation_deg": "rotation", "direction_deg": "direction of translation"}


def conditioning(analysis: dict[str, Any], table: pd.DataFrame) -> dict[str, Any] | None:
    """What the report adds to the analysis; None where no pair was judged.

    Args:
        analysis: as plain data.
        table: the records.

    Returns:
        ``told``, a sentence or some per quantity, and ``marks``, one per lead-in and gap.
    """
    if not analysis["conditioning"]:
        return None
    return {"told": [_told(errors) for errors in analysis["conditioning"]], "marks": _marks(table)}


def _marks(table: pd.DataFrame) -> list[dict[str, Any]]:
    names = ("baseline_m", *QUANTITIES)
    return [
        {"unit_id": row["unit_id"], "gap": gap}
        | {name: as_data(row[pair_column(gap, name)]) for name in names}
        for row in lead_ins(table).to_dict("records")
        for gap in PAIR_GAPS
        if as_data(row[pair_column(gap, "baseline_m")]) is not None
    ]


def _told(errors: dict[str, Any]) -> str:
    what, slope = QUANTITY_WORDS[errors["quantity"]], errors["slope"]
    of = f"{plural(errors['lead_ins'], 'lead-in')} in {plural(errors['worlds'], 'world')}"
    if slope["value"] is None:
        return f"Error of the {what}: no slope can be told of {of}."
    within = ends(slope)
    interval = f" ({within})" if within else ", without an interval"
    said = (
        f"Error of the {what}: the slope of its logarithm on that of the baseline is {number(slope['value'])}"
        f"{interval}, of {of}: with twice the baseline {number(2 ** slope['value'])} times the error. "
    )
    steps = [(f"from {s['narrow']} to {s['wide']} frames apart", _sign(s["slope"])) for s in errors["steps"]]
    others = [f"{where} it {_WAYS[sign]}" for where, sign in steps if sign not in (0, _sign(slope))]
    return said + "; ".join([f"Over all gaps it {_WAYS[_sign(slope)]}", *others]) + "."


_WAYS = {-1: "falls as the baseline grows", 1: "rises with the baseline", 0: "is not told to fall or to rise"}


def _sign(slope: dict[str, Any]) -> int:
    """-1 or 1 where the interval lies on one side of zero, else 0."""
    low, high = slope["low"], slope["high"]
    if low is None or high is None:
        return 0
    return 1 if low > 0 else -1 if high < 0 else 0
