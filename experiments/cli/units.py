"""Common parts of the commands that run units: options, progress."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dslab.experiments.cli.console import print_error_line, progress_bars

if TYPE_CHECKING:
    from dslab.experiments.campaign.runner import SystemTally, Tally

TIMEOUT_S, MEMORY_MB = 1800.0, 4000  # as of experiments.campaign.workers, which is slow to import
CoresOption = Annotated[
    int | None, typer.Option("--workers", min=1, help="Processes; default: one per core.")
]
TimeoutOption = Annotated[float, typer.Option("--timeout", min=1, help="Time limit of a unit in seconds.")]
MemoryOption = Annotated[
    int,
    typer.Option(
        "--memory", min=0, metavar="MB", help="Memory limit of a worker; a unit above it is retried; 0: none."
    ),
]
RetryErrorsOption = Annotated[
    bool, typer.Option("--retry-errors", help="Retry units that were given up for infrastructure errors.")
]
RerunDamagedOption = Annotated[
    bool, typer.Option("--rerun-damaged", help="Drop damaged rows of the ledger and run their units again.")
]


def estimates_text(tally: "Tally") -> str:
    """Running estimates of each system as shares; intervals would not be valid under repeated looks."""
    of_each = [
        (f"{each.system}: " if len(tally.systems) > 1 else "") + _shares_text(each) for each in tally.systems
    ]
    found = [f"{tally.void} void"] + ([f"{tally.errors} errors"] if tally.errors else [])
    return "; ".join(filter(None, ["; ".join(of_each), ", ".join(found)]))


def _shares_text(each: "SystemTally") -> str:
    def part(label: str, events: int, of: int) -> str:
        return f"{label} {f'{events / of:.2f}' if of else '-'} ({events}/{of})"

    if each.crossing:
        return part("no thread crosses", each.uncrossed, each.crossing)
    failures = "dual failures" if each.has_threads else "system failures"
    return f"{part('p0', each.breakages, each.completed)}, {part(failures, each.failures, each.completed)}"


@contextmanager
def unit_progress(
    name: str, folder: Path, estimates: Callable[["Tally"], str] = estimates_text
) -> Iterator[Callable[["Tally"], None]]:
    """Show count, time left and, below them, the estimates; an interrupt says how to go on."""
    with progress_bars() as show:

        def shown(tally: "Tally") -> None:
            at_work = f"{tally.workers} at work" if tally.workers else "waiting for workers"
            show("units", tally.done, tally.total, f"{name}: {estimates(tally)}, {at_work}")

        try:
            yield shown
        except KeyboardInterrupt:
            print_error_line(f"{folder} keeps the finished units: run the same command again to resume")
            raise
