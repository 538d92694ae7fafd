"""``dslab render``: a scenario and a seed become a folder of frames and truth."""

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

ScenarioArgument = Annotated[
    str, typer.Argument(help="Name of a scenario (see `dslab scenarios list`) or a .yaml file.")
]


def render_command(
    scenario: ScenarioArgument,
    out: Annotated[Path, typer.Option(help="Folder to make; must be new or empty.", show_default=False)],
    seed: Annotated[
        int | None, typer.Option(min=0, help="Root seed; default: the scenario's own.", show_default=False)
    ] = None,
    depth: Annotated[bool, typer.Option("--depth", help="Also write depth images (16 bit, 5000/m).")] = False,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Render anew and keep nothing in the cache.")
    ] = False,
) -> None:
    """Render a scenario to a TUM-form folder: frames, exact ground truth, segments.

    For example:
    dslab render clean-room --out out/room

    dslab render stressed --seed 3 --depth --out out/stressed-3

    dslab render kitti-like/07 --seed 1 --out out/kitti-like-07

    dslab render mine.yaml --no-cache --out out/mine
    """
    from scenarios.loading import load_scenario
    from sim.io.tum import claim_output_dir
    from sim.render import render_sequence

    what = load_scenario(scenario, seed)
    claim_output_dir(out)
    started_s = time.monotonic()
    # Beside the result, where there is room for it.
    scratch = tempfile.TemporaryDirectory(prefix=".dslab-", dir=out.parent) if no_cache else nullcontext()
    with scratch as folder, progress_bar() as told:
        cache_dir = Path(folder) if folder else None
        sequence = render_sequence(what, out_dir=out, cache_dir=cache_dir, depth=depth, progress=told)
    for segment in sequence.segments:
        span = f"frames {segment.first_frame} to {segment.last_frame}"
        typer.echo(f"  {segment.kind}: {span if segment.first_frame >= 0 else 'acts on no frame'}")
    typer.echo(f"{out}: {len(sequence)} frames in {time.monotonic() - started_s:.1f} s")


@contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int], None]]:
    """A rich progress bar on stderr, one line per step, as a callback ``(step, done, total)``."""
    columns = (TextColumn("{task.description:<12}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        tasks: dict[str, TaskID] = {}

        def update(step: str, done: int, total: int) -> None:
            if step not in tasks:
                tasks[step] = bar.add_task(step, total=total)
            bar.update(tasks[step], completed=done)

        yield update
