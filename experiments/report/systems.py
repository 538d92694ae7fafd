"""Systems beside each other: shares of each, paired differences, and what each says of itself."""

from typing import TYPE_CHECKING, Any

import pandas as pd

from dslab.experiments.eq1.records import Outcome
from dslab.experiments.eq1.units import RECOVERING, system_label
from dslab.experiments.report.outcomes import completed, rows_where
from dslab.experiments.report.plain_data import as_data, counted
from dslab.experiments.statistics.systems import compare_systems

if TYPE_CHECKING:
    from dslab.experiments.eq1.spec import ExperimentSpec
    from dslab.experiments.eq1.unit_drawing import Cell


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
        ``names`` of the systems, ``shares``, ``over_doses``, ``per_condition`` and ``about``; None for a
        single system with recovery threads, which the other parts of a report tell.
    """
    systems = labels(spec)
    names = list(dict.fromkeys(systems.values()))
    if len(names) == 1 and all(map(asks_eq1, spec.cells.values())):
        return None
    table = rows_where(table, table["cell"].isin(list(systems)))
    images = {name: cell.image for name, cell in spec.cells.items()}
    found = compare_systems(table, len(spec.threads), systems, images)
    of = table["cell"].map(systems)
    return {
        "names": names,
        **as_data(found),
        "about": [_about(name, rows_where(table, of == name)) for name in names],
    }


def _about(name: str, rows: pd.DataFrame) -> dict[str, Any]:
    done, void = completed(rows), rows_where(rows, rows["outcome"] == Outcome.VOID)
    return {
        "system": name,
        "declares": counted(rows["declares"]),
        "ended": counted(rows["ended"]),
        "completed": len(done),
        "void": len(void),
        "breakage_reasons": counted(done["breakage_reason"]),
        "mission_causes": counted(done["mission_cause"]),
    }
