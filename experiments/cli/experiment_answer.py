"""The answer of an experiment in a terminal: what its page says first."""

from collections.abc import Mapping, Sequence
from typing import Any

from dslab.experiments.cli.console import out, print_rows, say

FAILURES = {"breakage": "breaks", "system_failure": "system\nfails", "mission_failure": "mission\nfails"}


def print_report(report: Mapping[str, Any]) -> None:
    """Print warnings, systems, verdict, paragraph, and predicted and measured shares of a report."""
    from dslab.experiments.report.describe import ends_percent, percent

    print_warnings(report["warnings"])
    if report["systems"]:
        print_systems(report["systems"], report["conditions"])
    answer = report["answer"]
    out.print(answer["headline"])
    out.print(" ".join(answer["sentences"]))
    rows = (
        {
            "kind of world": row["world"],
            "worlds": row["worlds"],
            "n": row["n"],
            "Eq. 1": percent(row["eq1"]),
            "weakest link": percent(row["weakest"]),
            "measured": percent(row["measured"]["value"]) if row["measured"] else None,
            "95 %, by worlds": ends_percent(row["measured"]) if row["measured"] else None,
        }
        for row in answer["rows"]
    )
    if answer["rows"]:
        print_rows(rows)


def print_warnings(warnings: Sequence[str]) -> None:
    """Print a line per warning."""
    for warning in warnings:
        say(f"note: {warning}")


def print_systems(beside: Mapping[str, Any], conditions: Sequence[Mapping[str, Any]]) -> None:
    """Print a row per condition and system: trials, and shares of them that fail, in percent.

    Args:
        beside: ``systems`` of a report.
        conditions: its conditions.
    """
    stress = {condition["cell"]: condition["stress"] for condition in conditions}
    shares = sorted(beside["shares"], key=lambda point: [*stress].index(point["cell"]))
    several = len({point["world"] for point in shares}) > 1
    print_rows(
        (
            {
                "condition": stress[point["cell"]],
                **({"world": point["world"]} if several else {}),
                "system": point["system"],
                "trials": point["units"],
                **{name: _percent(point["shares"].get(failure)) for failure, name in FAILURES.items()},
            }
            for point in shares
        ),
        "% of the trials that fail, with 95 % intervals by worlds",
    )


def _percent(share: Mapping[str, float] | None) -> str | None:
    if share is None:
        return None
    value, low, high = (f"{100 * share[name]:.0f}" for name in ("value", "low", "high"))
    return f"{value} [{low}, {high}]"
