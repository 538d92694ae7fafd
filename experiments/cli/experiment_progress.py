"""Progress of a running experiment on the terminal."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import TYPE_CHECKING

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from experiments.cli.console import err

if TYPE_CHECKING:
    from experiments.campaign.runner import Tally


@contextmanager
def experiment_progress(name: str) -> Iterator[Callable[["Tally"], None]]:
    """Show a bar with rate, time left and estimates on stderr; yields its update callback."""
    texts = (TextColumn(f"{{task.{text}}}", markup=False) for text in ("fields[experiment]", "description"))
    columns = (next(texts), BarColumn(), MofNCompleteColumn(), *texts)
    started_s = time.monotonic()
    with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as progress:
        task = progress.add_task("starting", experiment=name)

        def show(tally: "Tally") -> None:
            pace = pace_text(tally, time.monotonic() - started_s)
            progress.update(
                task, completed=tally.done, total=tally.total, description=f"{pace}, {estimates_text(tally)}"
            )

        yield show


def pace_text(tally: "Tally", elapsed_s: float) -> str:
    """Units per hour and time left, from this run."""
    if tally.workers == 0:
        return "waiting for workers"
    if not tally.ended_here:
        return f"{tally.workers} at work"
    each_s = elapsed_s / tally.ended_here
    left = timedelta(seconds=round(each_s * (tally.total - tally.done)))
    return f"{3600 / each_s:.0f}/h, {left} left"


def estimates_text(tally: "Tally") -> str:
    """Running estimates as shares; intervals would not be valid under repeated looks."""

    def part(label: str, events: int) -> str:
        share = f"{events / tally.completed:.2f}" if tally.completed else "-"
        return f"{label} {share} ({events}/{tally.completed})"

    text = f"{part('p0', tally.breakages)}, {part('dual failures', tally.failures)}, {tally.void} void"
    return text + (f", {tally.errors} errors" if tally.errors else "")
