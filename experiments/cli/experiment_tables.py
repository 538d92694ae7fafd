"""Results of the commands of ``dslab experiment`` as text."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from dslab.experiments.cli.console import out, print_table

if TYPE_CHECKING:
    from dslab.experiments.campaign.replay import Replay
    from dslab.experiments.campaign.status import ExperimentStatus


def print_answer(answer: dict[str, Any]) -> None:
    """Print verdict, paragraph, and predicted and measured shares of a report.

    Args:
        answer: of report.json: ``headline``, ``sentences``, and ``rows`` per kind of world and n.
    """
    from dslab.experiments.report.describe import ends_percent, percent

    out.print(answer["headline"], markup=False)
    out.print(" ".join(answer["sentences"]), markup=False)
    table = Table()
    for column in ("kind of world", "worlds", "n", "Eq. 1", "weakest link", "measured", "95 %, by worlds"):
        table.add_column(column, justify="left" if column == "kind of world" else "right")
    for row in answer["rows"]:
        shares = (percent(row["eq1"]), percent(row["weakest"]))
        measured = row["measured"]
        of = (percent(measured["value"]), ends_percent(measured)) if measured else ("-", "-")
        table.add_row(row["world"], str(row["worlds"]), str(row["n"]), *shares, *of)
    if answer["rows"]:
        print_table(table)


def status_table(status: "ExperimentStatus") -> Table:
    """Table with the counts of every cell."""
    table = Table(title=f"{status.name} ({status.spec_hash[:12]})")
    table.add_column("cell")
    for column in ("units", "count", "no\nstress", "void", "errors", "break", "all\nfail"):
        table.add_column(column, justify="right")
    for cell in status.cells:
        ended = f"{cell.units} / {cell.budget}"
        counts = (cell.completed, cell.unexposed, cell.void, cell.errors, cell.breakages, cell.failures)
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
    else:
        out.print("agrees with the ledger in every column except time and memory")
    if rerun is not None and rerun.is_file():
        out.print(f"open it: dslab view {rerun}")
