"""Systems beside each other: shares of each, paired differences, and what each says of itself."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from dslab.experiments.eq1.arms import LEAD_IN_ERROR_SHARE
from dslab.experiments.eq1.records import SHAM, Outcome, failure_column
from dslab.experiments.eq1.units import RECOVERING, system_label
from dslab.experiments.report.outcomes import completed, rows_where
from dslab.experiments.report.plain_data import as_data, counted, is_true
from dslab.experiments.statistics.systems import compare_systems
from dslab.experiments.statistics.world_intervals import share_interval

if TYPE_CHECKING:
    from dslab.experiments.eq1.spec import ExperimentSpec
    from dslab.experiments.eq1.unit_drawing import Cell


MOST_FAILING_SHAMS = 0.1
"""Share of shams that may fail: above it, more than a tenth of the trials fail whatever the stress."""


def asks_eq1(cell: "Cell") -> bool:
    """True if the cell's system has recovery threads."""
    return cell.system in RECOVERING


def labels(spec: "ExperimentSpec") -> dict[str, str]:
    """System of each cell, by the name that it has in results."""
    return {name: system_label(cell.system) for name, cell in spec.cells.items()}


def beside_each_other(spec: "ExperimentSpec", table: pd.DataFrame) -> dict[str, Any] | None:
    """The figures of ``statistics.systems``, and of each system its words, ends and reasons.

    Args:
        spec: of the experiment.
        table: records of all systems.

    Returns:
        ``names`` of the systems, ``shares``, ``over_doses``, ``per_condition``, ``gains`` and ``about``; None
        for a single system with recovery threads of which Eq. 1 is asked, or its threads alone: the other
        parts of a report tell it.
    """
    systems = labels(spec)
    names = list(dict.fromkeys(systems.values()))
    told = "crossing" in spec.arms or "free" not in spec.arms
    if len(names) == 1 and all(map(asks_eq1, spec.cells.values())) and told:
        return None
    table = rows_where(table, table["cell"].isin(list(systems)))
    images = {name: cell.image for name, cell in spec.cells.items()}
    found = compare_systems(table, len(spec.threads), systems, images)
    of = table["cell"].map(systems)
    return {
        "names": names,
        **as_data(found),
        "about": [_about(name, rows_where(table, of == name), len(spec.threads)) for name in names],
    }


def sham_warnings(table: pd.DataFrame, threads: int, folder: Path) -> list[str]:
    """Warn of systems that fail without stress, or of which no unit counts.

    Args:
        table: records of all systems.
        threads: number of recovery threads of the experiment.
        folder: of the experiment, for commands that replay units.
    """

    def first(rows: pd.DataFrame) -> str:
        unit = shlex.quote(f"{rows['cell'].iloc[0]}:{rows['index'].iloc[0]}")
        return f"See one: dslab experiment replay {shlex.quote(str(folder))} {unit}"

    warnings = []
    for name, rows in table.groupby("system", sort=False):
        done, void = completed(rows), rows_where(rows, rows["outcome"] == Outcome.VOID)
        if len(void) and not len(done):
            reason = next(iter(counted(void["void_reason"])), "no reason given")
            warnings.append(
                f"Nothing is known of {name}: all its {len(void)} trials are void, most for: {reason}. "
                "A trial counts where the system tracks at the onset, and its path until then fits the truth "
                f"to {LEAD_IN_ERROR_SHARE:.0%}. {first(void)}"
            )
        shams = rows_where(done, done["kind"] == SHAM)
        failed = rows_where(shams, is_true(shams["breakage"]) | is_true(shams[failure_column("m", threads)]))
        if len(failed) > MOST_FAILING_SHAMS * len(shams):
            reasons = counted(failed["breakage_reason"].fillna(failed["mission_cause"]))
            why = f", most for: {next(iter(reasons)).replace('_', ' ')}" if reasons else ""
            warnings.append(
                f"{name} fails without stress in {len(failed)} of {len(shams)} trials{why}: "
                "what it does under stress is not the stress's alone. "
                f"{first(failed)}"
            )
    return warnings


def _about(name: str, rows: pd.DataFrame, threads: int) -> dict[str, Any]:
    done, void = completed(rows), rows_where(rows, rows["outcome"] == Outcome.VOID)
    return {
        "system": name,
        "declares": counted(rows["declares"]),
        "ended": counted(rows["ended"]),
        "completed": len(done),
        "void": len(void),
        "breakage_reasons": counted(done["breakage_reason"]),
        "mission_causes": counted(done["mission_cause"]),
        "under_stress": _under_stress(done, failure_column("m", threads)),
    }


def _under_stress(done: pd.DataFrame, column: str) -> list[dict[str, Any]]:
    """Share of the trials with a stress in which a failure happens, per kind of world.

    Conditions are weighted alike, and worlds are the sample.
    """
    stressed = rows_where(done, (done["kind"] != SHAM) & done[column].notna())
    found = []
    for world, own in stressed.groupby("world", sort=False):
        means = own[column].astype(float)
        for kept in (["world_seed", "cell", "sequence"], ["world_seed", "cell"], ["world_seed"]):
            keys = [means.index.get_level_values(k) if k in means.index.names else own[k] for k in kept]
            means = means.groupby(keys).mean()
        share = as_data(share_interval(means.to_numpy(float)))
        found.append({"world": world, "worlds": len(means), "units": len(own), "mission_failure": share})
    return found
