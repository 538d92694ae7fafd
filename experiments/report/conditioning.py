"""Pose error against baseline, as sentences and as points of its plot."""

from typing import Any

import pandas as pd

from dslab.experiments.eq1.records import PAIR_GAPS, pair_column
from dslab.experiments.report.describe import ends, number, plural
from dslab.experiments.report.plain_data import as_data
from dslab.experiments.statistics.conditioning import QUANTITIES, lead_ins

QUANTITY_WORDS = {"rotation_deg": "rotation", "direction_deg": "direction of translation"}


def conditioning(analysis: dict[str, Any], table: pd.DataFrame) -> dict[str, Any] | None:
    """Describe the pose errors of an analysis; None if no pair was judged.

    Returns:
        ``told``, the sentences about each quantity, and ``marks``, one per lead-in and gap.
    """
    if not analysis["conditioning"]:
        return None
    return {"told": [_sentences(errors) for errors in analysis["conditioning"]], "marks": _marks(table)}


def _marks(table: pd.DataFrame) -> list[dict[str, Any]]:
    names = ("baseline_m", *QUANTITIES)
    return [
        {"unit_id": row["unit_id"], "gap": gap}
        | {name: as_data(row[pair_column(gap, name)]) for name in names}
        for row in lead_ins(table).to_dict("records")
        for gap in PAIR_GAPS
        if as_data(row[pair_column(gap, "baseline_m")]) is not None
    ]


def _sentences(errors: dict[str, Any]) -> str:
    name, slope = QUANTITY_WORDS[errors["quantity"]], errors["slope"]
    sample = f"{plural(errors['lead_ins'], 'lead-in')} in {plural(errors['worlds'], 'world')}"
    if slope is None:
        return f"Error of the {name}: no slope can be estimated from {sample}."
    interval = f" ({ends(slope)})" if None not in (slope["low"], slope["high"]) else ", without an interval"
    text = (
        f"Error of the {name}: the slope of its logarithm over that of the baseline is "
        f"{number(slope['value'])}{interval}, from {sample}: twice the baseline gives "
        f"{number(2 ** slope['value'])} times the error. "
    )
    steps = [(f"from {s['narrow']} to {s['wide']} frames apart", _sign(s["slope"])) for s in errors["steps"]]
    others = [f"{where} it {_WAYS[sign]}" for where, sign in steps if sign not in (0, _sign(slope))]
    return text + "; ".join([f"Over all gaps it {_WAYS[_sign(slope)]}", *others]) + "."


_WAYS = {
    -1: "falls as the baseline grows",
    1: "rises with the baseline",
    0: "neither falls nor rises significantly",
}


def _sign(slope: dict[str, Any] | None) -> int:
    """Sign of a slope whose interval excludes zero, else 0."""
    low, high = (slope["low"], slope["high"]) if slope else (None, None)
    if low is None or high is None:
        return 0
    return 1 if low > 0 else -1 if high < 0 else 0
