"""Progress of a running experiment on the terminal."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.text import Text

from dslab.experiments.cli.console import err, progress_bars

if TYPE_CHECKING:
    from dslab.experiments.campaign.runner import Tally


class _Bar(Progress):
    """A bar over the whole width, with the estimates on a line of their own."""

    estimates = ""

    def get_renderables(self) -> Iterable[RenderableType]:
        yield from super().get_renderables()
        yield Text(self.estimates)


@contextmanager
def experiment_progress(
    name: str, estimates: Callable[["Tally"], str] | None = None
) -> Iterator[Callable[["Tally"], None]]:
    """Show count, bar, pace and time left, and below them the estimates; yields its update callback.

    Args:
        name: what runs.
        estimates: the estimates as text; None for the shares of an experiment.
    """
    columns = (
        MofNCompleteColumn(),
        BarColumn(bar_width=None),
        TextColumn("{task.description}", markup=False),
    )
    with progress_bars():
        pass  # compiles the kernels, which no worker is to do
    started_s = time.monotonic()
    with _Bar(*columns, console=err, transient=True, disable=not err.is_terminal, expand=True) as progress:
        progress.estimates = name
        task = progress.add_task("starting")

        def show(tally: "Tally") -> None:
            pace = pace_text(tally, time.monotonic() - started_s)
            progress.estimates = f"{name}: {(estimates or estimates_text)(tally)}"
            progress.update(task, completed=tally.done, total=tally.total, description=pace)

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

    def part(label: str, events: int, of: int) -> str:
        return f"{label} {f'{events / of:.2f}' if of else '-'} ({events}/{of})"

    found = (
        [part("no thread crosses", tally.uncrossed, tally.crossing)]
        if tally.crossing
        else [
            part("p0", tally.breakages, tally.completed),
            part("dual failures", tally.failures, tally.completed),
        ]
    )
    found += [f"{tally.void} void"] + ([f"{tally.errors} errors"] if tally.errors else [])
    return ", ".join(found)
