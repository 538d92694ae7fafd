"""Tables I to III and Figures 6, 7 and 9 of the paper, from an experiment.

Families of cells take the place of the paper's data sets. The data and the failures differ from the paper's:
compare patterns, not numbers.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd

from dslab.experiments.eq1.records import SHAM, dual_column, thread_column
from dslab.experiments.report.outcomes import completed, recovered, rows_where
from dslab.experiments.report.plain_data import as_data, is_true, numbers, of_trials, spread

UNITS_PER_CELL_OF_TIMELINE = 10
"""Number of trials per sequence in the paper."""


def table_1(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Accuracy per cell: median ATE of base and Dual-SLAM, shares tracked and failed.

    The ATE is over keyframes, as in the paper.
    """
    medians = {"median_ate_m": "keyframe_ate_m", "median_share_tracked": "share_tracked"}
    medians["median_path_share"] = "path_share"
    return [
        {"cell": cell, "units": len(units)}
        | {
            system: {name: _median(units[f"{system}_{column}"]) for name, column in medians.items()}
            | {
                "units_with_ate": int(units[f"{system}_keyframe_ate_m"].notna().sum()),
                "failed": of_trials(units[f"{system}_failure"]),
            }
            for system in ("base", "dual")
        }
        for cell, units in completed(table).groupby("cell", sort=False)
    ]


def tables_2_and_3(
    table: pd.DataFrame, threads: int, families: Mapping[str, str], systems: Mapping[str, str]
) -> dict[str, list[dict[str, Any]]]:
    """Per system and family the failures for each number of threads, and the recoveries.

    Args:
        table: the records.
        threads: n.
        families: family of each cell, in place of the paper's data sets.
        systems: system of each cell.

    Returns:
        ``table_2``: failures of base and Dual-SLAM. ``table_3``: recoveries that were needed, failed, and
        succeeded by thread, with their mean CPU time.
    """
    groups = list(_groups(completed(table), families, systems))
    return {
        "table_2": [names | _failure_rates(units, threads) for names, units in groups],
        "table_3": [names | _recoveries(units, threads) for names, units in groups],
    }


def _groups(
    rows: pd.DataFrame, families: Mapping[str, str], systems: Mapping[str, str]
) -> Iterator[tuple[dict[str, str], pd.DataFrame]]:
    """Yield the units of each system, per family and then all, without the shams."""
    families = {cell: family for cell, family in families.items() if family != SHAM}
    rows = rows_where(rows, rows["kind"] != SHAM)
    system_of, family_of = rows["cell"].map(systems), rows["cell"].map(families)
    for system in dict.fromkeys(systems.values()):
        own = rows_where(rows, system_of == system)
        for family in dict.fromkeys(families.values()):
            yield {"system": system, "family": family}, rows_where(own, family_of[own.index] == family)
        yield {"system": system, "family": "all"}, own


def _failure_rates(units: pd.DataFrame, threads: int) -> dict[str, Any]:
    levels = [of_trials(units[dual_column(n)]) for n in range(1, threads + 1)]
    shares = {name: of_trials(units[name]) for name in ("breakage", "base_failure")}
    shipped = of_trials(units["dual_failure"])
    left = shipped["events"]
    return {
        **shares,
        "dual": levels,
        "dual_as_shipped": shipped,
        **{
            f"reduction_of_{name}": 1 - left / share["events"] if share["events"] else None
            for name, share in shares.items()
        },
    }


def _recoveries(units: pd.DataFrame, threads: int) -> dict[str, Any]:
    broken = units[is_true(units["breakage"])]
    waiting = pd.Series(True, index=broken.index)
    cpu_s = pd.Series(0.0, index=broken.index)
    with_thread = []
    for thread in range(1, threads + 1):
        # The system runs one thread after the other until one declares success, even falsely.
        cpu_s += (
            broken[thread_column("free", thread, "cpu_ms")].fillna(0).astype(float).where(waiting, 0) / 1e3
        )
        declared = waiting & is_true(broken[thread_column("free", thread, "declared")])
        with_thread.append(int((declared & recovered(broken, thread)).sum()))
        waiting &= ~declared
    attempted = is_true(broken["reinit"])
    return {
        "trials": len(units),
        "needs_recovery": len(broken),
        "failure": len(broken) - sum(with_thread),
        "no_reinit": int((~attempted).sum()),
        "success": sum(with_thread),
        "with_thread": with_thread,
        "mean_recovery_cpu_s": float(cpu_s[attempted].mean()) if attempted.any() else None,
    }


def initialisation(
    table: pd.DataFrame, systems: Mapping[str, str], frames_per_s: Mapping[str, float]
) -> list[dict[str, Any]]:
    """Seconds to a new map per cell, after the breakage and after the exposed segment."""

    def seconds(units: pd.DataFrame, after: str, at: str, cell: str) -> dict[str, Any]:
        return spread((units[at] - units[after]).astype("Float64") / frames_per_s[cell])

    return [
        {
            "cell": cell,
            "system": systems[str(cell)],
            "after_breakage_s": seconds(units, "breakage_frame", "reinit_frame", str(cell)),
            "after_segment_s": seconds(units, "end_frame", "cross_reinit_frame", str(cell)),
        }
        for cell, units in completed(table).groupby("cell", sort=False)
    ]


def timeline(table: pd.DataFrame, frames: Mapping[str, int]) -> list[dict[str, Any]]:
    """Profiles of the first trials of every cell: frames of breakage and reinitialization."""
    names = ["unit_id", "index", "onset_frame", "end_frame", "breakage_frame", "reinit_frame", "breakage"]
    names += ["relocalized", "base_failure", "silent_failure", "dual_failure", "free_frames_to_cross"]
    profiles = []
    for cell, units in completed(table).groupby("cell", sort=False):
        shown = units.sort_values("index").head(UNITS_PER_CELL_OF_TIMELINE)[names]
        shown = shown.rename(columns={"free_frames_to_cross": "frames_to_cross"})
        rows = as_data(shown.to_dict("records"))
        profiles.append({"cell": cell, "frames": frames[str(cell)], "units": rows})
    return profiles


def end_errors(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Position error of the last pose in metres per cell and unit, or None."""
    return [
        {
            "cell": cell,
            "index": [int(i) for i in units["index"]],
            "base_m": as_data(units["base_end_error_m"].tolist()),
            "dual_m": as_data(units["dual_end_error_m"].tolist()),
            "base_failed": is_true(units["base_failure"]).tolist(),
            "dual_failed": is_true(units["dual_failure"]).tolist(),
        }
        for cell, own in completed(table).groupby("cell", sort=False)
        for units in [own.sort_values("index")]
    ]


def _median(column: pd.Series) -> float | None:
    values = numbers(column)
    return float(pd.Series(values).median()) if values else None
