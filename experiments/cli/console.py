"""Common parts of the commands: options, consoles, progress bars, tables."""

import json
import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich import box
from rich.console import Console, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.syntax import Syntax
from rich.table import Table
from rich.text import Text

from dslab.scenarios.errors import InputError

if TYPE_CHECKING:
    from dslab.sim.sequence import SegmentTruth

# Names of files and scenarios are printed everywhere: nothing that is printed is markup.
_PLAIN: Any = {"markup": False, "emoji": False, "highlight": False}
out = Console(**_PLAIN)
err = Console(stderr=True, **_PLAIN)
_MOST_SEED = 2**63 - 1  # larger ones could not be read back from the files that name them
LOG_EVERY_S = 60.0
"""Between the lines of progress of a command without a terminal."""
_OF_FIGURES = "-.0123456789"


FormName = Literal["tum", "kitti", "euroc", "vslam-lab"]
"""Writable forms of sequence folders."""
TruthFormName = Literal["tum", "kitti", "euroc"]
ModeName = Literal["lockstep", "threaded"]
SystemName = Literal["base", "dual", "dual+", "orbslam", "paper", "paper+", "dso", "ldso"]


def _check_seed(seed: int | None) -> int | None:
    if seed is not None and seed > _MOST_SEED:
        raise typer.BadParameter("is more than 2^63 - 1")
    return seed


SeedOption = Annotated[
    int | None,
    typer.Option(
        "--seed",
        min=0,
        callback=_check_seed,
        metavar="N",
        help="Root seed of scenario and system; default: the scenario's own, or 0.",
        show_default=False,
    ),
]
ModeOption = Annotated[
    ModeName,
    typer.Option(
        "--mode",
        help="lockstep: the same seed gives the same bits; threaded: mapping and loop closing run in "
        "parallel with tracking.",
    ),
]
SystemsOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--systems",
        metavar="DIR",
        help="Folder with descriptions of other people's systems; repeatable, beside those in DSLAB_SYSTEMS.",
        show_default=False,
    ),
]
SourceArgument = Annotated[
    str,
    typer.Argument(help="A sequence folder, images, a video or ROS bag, or a scenario's name or YAML file."),
]
CameraOption = Annotated[
    Path | None,
    typer.Option(
        "--camera",
        metavar="FILE",
        help="Calibration of images, a video, a bag or a folder without one: see `dslab camera`.",
        show_default=False,
    ),
]
TruthOption = Annotated[
    Path | None,
    typer.Option(
        "--truth",
        metavar="FILE",
        help="True poses of the camera, on the clock of the frames.",
        show_default=False,
    ),
]
TruthFormOption = Annotated[
    TruthFormName, typer.Option("--truth-form", help="Form of --truth; kitti has a line per frame.")
]
RendererOption = Annotated[
    str | None, typer.Option("--renderer", help="Renderer of scenarios: mujoco (the default) or pyrender.")
]
FolderOption = Annotated[Path, typer.Option("--out", metavar="DIR", help="Output folder; absent or empty.")]
WorkersOption = Annotated[int, typer.Option("--workers", min=1, help="Processes.")]
RealTimeOption = Annotated[
    bool, typer.Option("--real-time", help="Feed frames at the rate of their stamps; late ones are dropped.")
]
NoRelocalizationOption = Annotated[
    bool,
    typer.Option(
        "--no-relocalization", help="Do not relocalize in saved maps until a new map is initialized."
    ),
]
ForceOption = Annotated[
    bool, typer.Option("--force", help="Begin even if the frames seem too many for the disk or the memory.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one line of JSON.")]


def check_real_time(real_time: bool, mode: ModeName) -> None:
    """Raise InputError for --real-time outside threaded mode."""
    if real_time and mode != "threaded":
        raise InputError("--real-time", f"the mode is {mode}", "add --mode threaded")


def single_threaded_opencv() -> None:
    """Switch off OpenCV's own threads, which would disturb measurements."""
    import cv2

    cv2.setNumThreads(1)


class _Bars(Progress):
    """Bars with a line below them."""

    note = ""

    def get_renderables(self) -> Iterable[RenderableType]:
        yield from super().get_renderables()
        if self.note:
            yield Text(self.note)


@contextmanager
def progress_bars(kernels: bool = True) -> Iterator[Callable[..., None]]:
    """Show progress on stderr, one bar per step; yields a callback of (step, done, total, note below).

    Without a terminal a line is written now and then, however long a step takes, so that a log tells that a
    long command goes on.

    Args:
        kernels: compile those that are not there yet, as a first step; False for what runs no SLAM.
    """
    columns = (TextColumn("{task.description}", markup=False), BarColumn(30), MofNCompleteColumn())
    times = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    with ExitStack() as stack, _Bars(
        *columns, *times, console=err, transient=True, disable=not err.is_terminal,
        speed_estimate_period=math.inf,
    ) as bars:  # fmt: skip
        tasks: dict[str, Any] = {}
        log = None if err.is_terminal else stack.enter_context(_log_now_and_then())

        def show(step: str, done: int, total: int, note: str = "") -> None:
            bars.note = note
            if step not in tasks:
                tasks[step] = bars.add_task(step)
            bars.update(tasks[step], completed=done, total=total)
            if log is not None:
                left_s = next(task.time_remaining for task in bars.tasks if task.id == tasks[step])
                left = f", about {math.ceil(left_s / 60)} min left" if left_s else ""
                log.update(state=f"{step}: {done} of {total}", left=left)

        if kernels:
            from dslab.experiments.kernels import compile_kernels

            compile_kernels(show)
        yield show


@contextmanager
def _log_now_and_then() -> Iterator[dict[str, str]]:
    """Write the state, of which the caller keeps the latest, and the time since the start to stderr."""
    log, ended, begun_s = {"state": "under way", "left": ""}, threading.Event(), time.monotonic()

    def write() -> None:
        while not ended.wait(LOG_EVERY_S):
            print_error_line(f"{log['state']}, {(time.monotonic() - begun_s) / 60:.0f} min{log['left']}")

    thread = threading.Thread(target=write, daemon=True)
    thread.start()
    try:
        yield log
    finally:
        ended.set()
        thread.join()


def table_of(rows: Iterable[Mapping[str, object]], title: str = "") -> Table:
    """A table with a column per key of its rows; None is a dash, an empty row a line of separation.

    Columns of figures stand right. Words too long for a narrow terminal are folded, never cut.
    """
    cells = [{name: "-" if value is None else str(value) for name, value in row.items()} for row in rows]
    table = Table(title=Text(title) if title else None, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.show_edge, table.title_justify = False, "left"
    columns = dict.fromkeys(name for row in cells for name in row)
    for name in columns:
        of_figures = all(row.get(name, "-")[:1] in _OF_FIGURES for row in cells)
        right = of_figures and name != next(iter(columns))
        table.add_column(name, justify="right" if right else "left", overflow="fold")
    for row in cells:
        if row:
            table.add_row(*(row.get(name, "") for name in columns))
        else:
            table.add_section()
    return table


def print_rows(rows: Iterable[Mapping[str, object]], title: str = "") -> None:
    """Print the table of :func:`table_of`."""
    out.print(table_of(rows, title))


def say(line: str) -> None:
    """Print one unwrapped line: names of folders can be copied from it."""
    out.print(line, soft_wrap=True)


def print_error_line(line: str) -> None:
    """Print one unwrapped line on stderr, whatever the names in it hold."""
    err.print(line.replace("\n", " "), soft_wrap=True)


def print_facts(facts: Mapping[str, object]) -> None:
    """Print a line per fact, never cut."""
    longest = max(map(len, facts))
    for name, value in facts.items():
        say(f"{name:{longest}s}  {value}")


def print_segments(segments: "Iterable[SegmentTruth]") -> None:
    """Print the frames on which each segment acts."""
    for segment in segments:
        span = f"frames {segment.first_frame} to {segment.last_frame}"
        out.print(f"  {segment.kind}: {span if segment.first_frame >= 0 else 'acts on no frame'}")


def print_json_line(value: Any) -> None:
    """Print one unwrapped line of JSON on stdout."""
    from dslab.experiments.runs.files import to_json

    print(to_json(value))


def print_yaml(text: str) -> None:
    """Print YAML as it is, in colours on a terminal."""
    if out.is_terminal:
        out.print(Syntax(text, "yaml", background_color="default"))
    else:
        print(text, end="")


def print_schema(schema: dict[str, Any]) -> None:
    """Print a JSON Schema."""
    print(json.dumps(schema, indent=2))


def number(value: float | None, digits: int = 3, unit: str = "") -> str:
    """Figure for a table; a dash for None."""
    return "-" if value is None else f"{value:.{digits}f}{unit}"


def share(value: float | None) -> str:
    """Share as a percentage; a dash for None."""
    return "-" if value is None else f"{100 * value:.1f} %"
