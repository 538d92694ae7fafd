"""Results of the commands of ``dslab experiment`` as text."""

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from experiments.cli.console import number, out, print_table

if TYPE_CHECKING:
    from experiments.campaign.replay import Replay
    from experiments.campaign.status import ExperimentStatus
    from experiments.statistics.reanalysis import Reanalysis


def print_answer(answer: dict[str, Any]) -> None:
    """Print verdict, measured and predicted shares of a report.

    Args:
        answer: of report.json: ``sentences``, the verdict first, and one of ``rows`` per n.
    """
    from experiments.report.describe import ends_percent, percent

    out.print(answer["sentences"][0])
    table = Table()
    for column in ("threads, n", "failures measured", "95 % interval", "predicted by Eq. 1"):
        table.add_column(column, justify="right")
    for row in answer["rows"]:
        table.add_row(str(row["n"]), percent(row["measured"]), ends_percent(row), percent(row["predicted"]))
    if answer["rows"]:
        print_table(table)


def print_reanalysis(found: "Reanalysis") -> None:
    """Print the figures of all cells together, then those of every cell in which something happened."""
    out.print(f"{found.units} units in {found.worlds} worlds, {found.void} void")
    table = Table(title="all cells, weighted by their units, %")
    columns = ("n", "Eq. 1 within\nkinds", "within\nworlds", "in one unit", "measured", "by worlds, 95 %")
    for column in columns:
        table.add_column(column, justify="right")
    for level in found.levels:
        by = level.by_worlds
        shares = (level.within_kinds, level.within_worlds, level.in_units, level.measured)
        ends = f"{100 * by.value:.1f} ({100 * by.low:.1f} to {100 * by.high:.1f})"
        table.add_row(str(level.n), *("-" if s is None else f"{100 * s:.1f}" for s in shares), ends)
    print_table(table)
    out.print(f"failed with all threads, or silently: {100 * found.failed_or_silent:.1f} %")
    table = Table(title="by cell and kind of world, %")
    columns = (
        "cell",
        "world",
        "n",
        "Eq. 1",
        "weakest",
        "in one unit",
        "measured",
        "mission",
        "over Eq. 1, 95 %",
    )
    for column in (*columns, "verdicts"):
        table.add_column(column, justify="left" if column in ("cell", "world", "verdicts") else "right")
    for c in found.cells:
        if any(c.worlds_with):
            figures = (c.units.product, c.units.weakest, c.units.measured, c.forecast.measured)
            both = f"{c.independence}, {c.prediction}"
            mission, ratio = c.shares.get("mission_failure"), c.steps.get("whole")
            of_mission = "-" if mission is None else f"{100 * mission.value:.1f}"
            over = (
                "-"
                if ratio is None
                else f"{number(ratio.value, 2)} ({_end(ratio.low)} to {_end(ratio.high)})"
            )
            each = (*(f"{100 * f.value:.1f}" for f in figures), of_mission, over, both)
            table.add_row(c.cell, c.world, str(c.n), *each)
    print_table(table)


def _end(value: float) -> str:
    return number(value, 2) if isfinite(value) else "unbounded"


def status_table(status: "ExperimentStatus") -> Table:
    """Table with the counts of every cell."""
    table = Table(title=f"{status.name} ({status.spec_hash[:12]})")
    table.add_column("cell")
    for column in ("units", "completed", "void", "errors", "breakages", "all\nthreads\nfailed"):
        table.add_column(column, justify="right")
    for cell in status.cells:
        ended = f"{cell.units} / {cell.budget}"
        counts = (cell.completed, cell.void, cell.errors, cell.breakages, cell.failures)
        table.add_row(cell.cell, ended, *map(str, counts))
    return table


def print_replay(done: "Replay", rerun: Path | None) -> None:
    """Print the outcome of a replayed unit and how it differs from the ledger."""
    record, unit = done.record, done.unit
    out.print(f"unit {unit.unit_id} ({unit.cell}:{unit.index}): {record['outcome']} {record['message']}")
    if done.recorded is None:
        out.print("not yet in the ledger")
    elif done.differing:
        for name in done.differing:
            out.print(f"{name}: {record[name]!r}, in the ledger {done.recorded[name]!r}")
        if record["code"] != done.recorded["code"]:
            out.print(f"the code has changed: the ledger is of commit {done.recorded['commit']}")
    else:
        out.print("agrees with the ledger in every column except time and memory")
    if rerun is not None and rerun.is_file():
        out.print(f"open it: dslab view {rerun}")
