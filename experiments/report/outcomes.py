"""Outcomes of the units: counts, list of failures, their reasons and stages."""

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from dslab.experiments.eq1.records import SHAM, Outcome, dual_column, failure_column, thread_column
from dslab.experiments.report.plain_data import as_data, counted, is_false, is_true, of_trials, spread
from dslab.experiments.statistics.from_records import is_exposed

ARMS = ("free", "cross")


def completed(table: pd.DataFrame) -> pd.DataFrame:
    """Completed units of a table whose stress, if they have one, acted."""
    return rows_where(table, (table["outcome"] == Outcome.COMPLETED) & is_exposed(table))


def rows_where(table: pd.DataFrame, mask: pd.Series) -> pd.DataFrame:
    """Rows in which a boolean column is true; null counts as false."""
    return table.loc[is_true(mask), :]


def unit_counts(table: pd.DataFrame, planned: dict[str, int]) -> dict[str, Any]:
    """Count planned, recorded, completed, void and failed units, in total and per cell."""
    per_cell = []
    for cell in dict.fromkeys([*planned, *table["cell"].dropna()]):
        rows = table[table["cell"] == cell]
        per_cell.append({"cell": cell, **_counts(rows, planned.get(cell, len(rows)))})
    total = {key: sum(row[key] for row in per_cell) for key in _counts(table[:0], 0)}
    return {**total, "per_cell": per_cell}


def _counts(rows: pd.DataFrame, planned: int) -> dict[str, int]:
    def of(outcome: Outcome) -> int:
        return int((rows["outcome"] == outcome).sum())

    return {
        "planned": planned,
        "recorded": len(rows),
        "missing": max(planned - len(rows), 0),
        "completed": of(Outcome.COMPLETED),
        "unexposed": int((~is_exposed(rows) & (rows["outcome"] == Outcome.COMPLETED)).sum()),
        "void": of(Outcome.VOID),
        "errors": of(Outcome.INFRASTRUCTURE_ERROR),
    }


def failures(table: pd.DataFrame, threads: int, folder: Path) -> list[dict[str, Any]]:
    """Units with a dual failure, a false recovery, a silent or a mission failure, in table order.

    Without the free arm: units that no thread crosses.
    """
    place = shlex.quote(str(folder))
    found = []
    for row in completed(table).to_dict("records"):
        if failed := _failures_of(row, threads):
            unit = str(row["unit_id"])
            found.append(
                {
                    "unit_id": unit,
                    "cell": row["cell"],
                    "index": int(row["index"]),
                    "world_seed": as_data(row["world_seed"]),
                    "what": failed,
                    "breakage_reason": as_data(row["breakage_reason"]) or "",
                    "threads": _thread_failures(row, threads),
                    "command": f"dslab experiment replay {place} {unit} --rerun {unit}.rrd",
                    "recording": None,
                }
            )
    return found


def happened(table: pd.DataFrame, threads: int) -> list[dict[str, Any]]:
    """What happened in every unit, in words: its outcome, a breakage, failures; in table order.

    Returns:
        Per unit its ``cell``, ``index`` and ``words``, and as ``rank`` 2 if it failed, 1 if it broke, else 0.
    """
    found = []
    for row in table.to_dict("records"):
        failed, broke = [], False
        words = [str(row["outcome"]).replace("_", " ")]
        if row["outcome"] == Outcome.COMPLETED:
            words = ["no stress acted"] if row["exposed"] is False else []
            reason = str(as_data(row["breakage_reason"]) or "").replace("_", " ")
            failed, broke = _failures_of(row, threads), _is_set(row["breakage"])
            words += [f"breakage ({reason})" if reason else "breakage"] if broke else []
            words += failed
        place = {"cell": row["cell"], "index": int(row["index"])}
        found.append(place | {"words": words or ["no failure"], "rank": 2 if failed else int(broke)})
    return found


def _failures_of(row: dict[Any, Any], threads: int) -> list[str]:
    """Names of the failures of a unit."""
    numbers = range(1, threads + 1)
    levels = [n for n in numbers if _is_set(row[dual_column(n)])]
    found = [f"dual failure (n = {', '.join(map(str, levels))})"] if levels else []
    for arm, place in (("free", ""), ("cross", " in the crossing arm")):
        false = [j for j in numbers if _is_set(row[thread_column(arm, j, "false")])]
        found += [f"false recovery by thread {j}{place}" for j in false]
    crossed = [thread_column("cross", j, "failed") for j in numbers]
    if pd.isna(row["breakage"]) and all(_is_set(row[failed]) for failed in crossed):
        found.append("no thread crosses")
    if _is_set(row["silent_failure"]):
        found.append("silent failure")
    if _is_set(row[failure_column("m", threads)]):
        cause = as_data(row["mission_cause"]) or "unknown"
        found.append(f"mission failure (first: {cause.replace('_', ' ')})")
    return found


def _thread_failures(row: dict[Any, Any], threads: int) -> list[dict[str, Any]]:
    arm: Literal["free", "cross"] = "cross" if pd.isna(row["breakage"]) else "free"
    return [
        {"thread": thread}
        | {name: as_data(row[thread_column(arm, thread, name)]) or "" for name in ("stage", "reason")}
        for thread in range(1, threads + 1)
        if _is_set(row[thread_column(arm, thread, "failed")])
    ]


def _is_set(value: Any) -> bool:
    return not pd.isna(value) and bool(value)


def worlds_of_kinds(table: pd.DataFrame) -> dict[str, int]:
    """Number of worlds of each kind in which a trial under stress is completed."""
    rows = completed(table)
    worlds = rows[rows["kind"] != SHAM].groupby("world", sort=False)["world_seed"].nunique()
    return {str(kind): int(count) for kind, count in worlds.items()}


def taxonomy(table: pd.DataFrame, threads: int) -> dict[str, Any]:
    """Reasons of breakages, stages and reasons of failed recoveries, silent failures, delays."""
    rows = completed(table)
    return {
        **_reasons(rows),
        "base_mission_causes": counted(rows["base_mission_cause"]),
        "per_cell": [
            {"cell": cell, **_reasons(of_cell)} for cell, of_cell in rows.groupby("cell", sort=False)
        ],
        "threads": [_thread_taxonomy(rows, arm, thread) for arm in ARMS for thread in range(1, threads + 1)],
    }


def _reasons(rows: pd.DataFrame) -> dict[str, Any]:
    return {
        "breakage_reasons": counted(rows["breakage_reason"][is_true(rows["breakage"])]),
        # Of the unbroken units.
        "silent": of_trials(rows.loc[is_false(rows["breakage"]), "silent_failure"]),
        "mission_causes": counted(rows["mission_cause"]),
        "declaration_delay_s": spread(rows["declaration_delay_s"]),
    }


def _thread_taxonomy(rows: pd.DataFrame, arm: Any, thread: int) -> dict[str, Any]:
    failed = rows[thread_column(arm, thread, "failed")]
    lost = rows[is_true(failed)]
    declared = is_true(rows[thread_column(arm, thread, "declared")])
    return {
        "arm": "free" if arm == "free" else "crossing",
        "thread": thread,
        "attempts": int(failed.notna().sum()),
        "failed": len(lost),
        "stages": counted(lost[thread_column(arm, thread, "stage")]),
        # Reasons that differ in their figures only are the same.
        "reasons": counted(
            lost[thread_column(arm, thread, "reason")].str.replace(r"[-+]?\d+(\.\d+)?", "…", regex=True)
        ),
        "false": of_trials(rows.loc[declared, thread_column(arm, thread, "false")].fillna(False)),
    }


def set_aside(table: pd.DataFrame, systems: Mapping[str, str]) -> dict[str, Any]:
    """Void lead-ins with their reasons, and infrastructure errors with their messages.

    A lead-in that ends without a healthy map voids its unit in every cell of its base; it counts once.

    Args:
        table: the records.
        systems: system of each cell; each has lead-ins of its own.
    """
    void = table[table["outcome"] == Outcome.VOID]
    lead_in = void.assign(system=void["cell"].map(systems))[["world", "world_seed", "index", "system"]]
    lead_ins = void[~lead_in.duplicated()]
    errors = table[table["outcome"] == Outcome.INFRASTRUCTURE_ERROR]
    retried = completed(table)
    names = ["unit_id", "cell", "index"]
    return {
        "void_lead_ins": len(lead_ins),
        "void_reasons": counted(lead_ins["void_reason"].fillna("no reason given")),
        "void": _records(lead_ins[names].assign(reason=lead_ins["void_reason"].fillna(""))),
        "errors": _records(
            errors[names].assign(message=errors["message"].fillna(""), attempts=errors["attempts"])
        ),
        "completed_after_errors": int((retried["attempts"].fillna(1) > 1).sum()),
    }


def _records(rows: pd.DataFrame) -> list[dict[str, Any]]:
    return as_data(rows.to_dict("records"))


def costs(table: pd.DataFrame) -> dict[str, Any]:
    """CPU time of the completed units in seconds, and their peak memory."""
    rows = completed(table)
    sums = {name: float(rows[name].fillna(0).sum()) for name in ("render_s", "slam_s", "cpu_s", "wall_s")}
    return sums | {"peak_rss_mb": max((float(v) for v in rows["peak_rss_mb"].dropna()), default=None)}


def sources(table: pd.DataFrame) -> dict[str, Any]:
    """Count the records of each state of the code."""
    return {"code": counted(table["code"]), "commits": counted(table["commit"])}


def recovered(rows: pd.DataFrame, thread: int) -> pd.Series:
    """True where a required recovery of the free arm aligned the maps."""
    return is_false(rows[thread_column("free", thread, "failed")])
