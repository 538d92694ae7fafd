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

from experiments.cli.console import FormatChoice, RendererOption

ScenarioArgument = Annotated[
    str, typer.Argument(help="Name of a scenario (see `dslab scenarios list`) or a .yaml file.")
]


def render_command(
    scenario: ScenarioArgument,
    out: Annotated[Path, typer.Option(help="Folder to make; must be new or empty.", show_default=False)],
    seed: Annotated[
        int | None, typer.Option(min=0, help="Root seed; default: the scenario's own.", show_default=False)
    ] = None,
    form: Annotated[
        FormatChoice, typer.Option("--format", help="The form to write; EuRoC's holds the scenario's IMU.")
    ] = FormatChoice.TUM,
    depth: Annotated[
        bool, typer.Option("--depth", help="Also write depth images (TUM form, 16 bit, 5000/m).")
    ] = False,
    renderer: RendererOption = None,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Render anew and keep nothing in the cache.")
    ] = False,
) -> None:
    """Render a scenario to a folder in TUM, KITTI or EuRoC form: frames, exact ground truth, segments.

    For example:
    dslab render clean-room --out out/room

    dslab render stressed --seed 3 --depth --out out/stressed-3

    dslab render kitti-like/07 --seed 1 --out out/kitti-like-07

    dslab render mine.yaml --format euroc --no-cache --out out/mine
    """
    from experiments.runs.sources import open_imu
    from scenarios.errors import InputError
    from scenarios.loading import load_scenario
    from sim.io.folders import check_free
    from sim.io.forms import Form, write_sequence
    from sim.rendering.renderers import DEFAULT_RENDERER
    from sim.sequence_rendering import render_backend, render_sequence

    what = load_scenario(scenario, seed)
    if depth and form is not FormatChoice.TUM:
        raise InputError("--depth", f"the form {form} has no depth images", "use --format tum")
    backend = render_backend(renderer or DEFAULT_RENDERER)
    check_free(out)
    started_s = time.monotonic()
    # Beside the result, where there is room for it.
    scratch = tempfile.TemporaryDirectory(prefix=".dslab-", dir=out.parent) if no_cache else nullcontext()
    with scratch as folder, progress_bar() as told:
        cache_dir = Path(folder) if folder else None
        sequence = render_sequence(what, cache_dir=cache_dir, depth=depth, progress=told, backend=backend)
        readings = open_imu(scenario, sequence.stamps_s, seed) if form is FormatChoice.EUROC else None
        write_sequence(sequence, out, Form(form.value), readings, depth, told)
    for segment in sequence.segments:
        span = f"frames {segment.first_frame} to {segment.last_frame}"
        typer.echo(f"  {segment.kind}: {span if segment.first_frame >= 0 else 'acts on no frame'}")
    took_s = time.monotonic() - started_s
    typer.echo(f"{out}: {len(sequence)} frames{', imu0' if readings else ''} in {took_s:.1f} s")
    if what.imu and not readings:
        typer.echo("  inertial readings are left out, use --format euroc")


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
