"""Common parts of the commands: options, consoles, progress bars."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

if TYPE_CHECKING:
    from dslab.sim.sequence import SegmentTruth

# Names of files and scenarios are printed everywhere: nothing that is printed is markup.
_PLAIN: Any = {"markup": False, "emoji": False, "highlight": False}
out = Console(**_PLAIN)
err = Console(stderr=True, **_PLAIN)


MOST_SEED = 2**63 - 1
"""Largest root seed: larger ones could not be read back from the files that name them."""


class FormatChoice(StrEnum):
    """Writable forms of sequence folders."""

    TUM = "tum"
    KITTI = "kitti"
    EUROC = "euroc"
    VSLAM_LAB = "vslam-lab"


class ModeChoice(StrEnum):
    """Scheduling of tracking, mapping and loop closing."""

    LOCKSTEP = "lockstep"
    THREADED = "threaded"


ModeOption = Annotated[
    ModeChoice,
    typer.Option(
        "--mode",
        help="lockstep: the same seed gives the same bits; threaded: mapping and loop closing run in "
        "parallel with tracking.",
    ),
]
RealTimeOption = Annotated[
    bool,
    typer.Option(
        "--real-time", help="Feed frames at the rate of their stamps; late ones are dropped and counted."
    ),
]
RendererOption = Annotated[
    str | None,
    typer.Option("--renderer", help="Renderer of scenarios: mujoco (the default) or pyrender."),
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
SourceArgument = Annotated[str, typer.Argument(help="A sequence folder, a scenario's name or its YAML file.")]
CameraOption = Annotated[
    Path | None,
    typer.Option(
        "--camera",
        metavar="FILE",
        help="camera.yaml of a folder of images without any list, or of a video file.",
        show_default=False,
    ),
]
FolderOption = Annotated[Path, typer.Option("--out", help="Output folder; absent or empty.")]
ForceOption = Annotated[
    bool, typer.Option("--force", help="Begin even if the frames seem too many for the disk or the memory.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one line of JSON.")]


def check_seed(seed: int | None) -> int | None:
    """Callback of options for a root seed: refuses one that could not be read back."""
    if seed is not None and seed > MOST_SEED:
        raise typer.BadParameter("is more than 2^63 - 1")
    return seed


def check_real_time(real_time: bool, mode: ModeChoice) -> None:
    """Raise InputError for --real-time outside threaded mode."""
    from dslab.scenarios.errors import InputError

    if real_time and mode is not ModeChoice.THREADED:
        raise InputError("--real-time", f"the mode is {mode}", "add --mode threaded")


def single_threaded_opencv() -> None:
    """Switch off OpenCV's own threads, which would disturb measurements."""
    import cv2

    cv2.setNumThreads(1)


@contextmanager
def progress_bars(kernels: bool = True) -> Iterator[Callable[[str, int, int], None]]:
    """Show progress on stderr, one bar per step; yields a callback of (step, done, total).

    Args:
        kernels: compile those that are not there yet, as a first step; False for what runs no SLAM.
    """
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as progress:
        tasks: dict[str, int] = {}

        def show(step: str, done: int, total: int) -> None:
            if step not in tasks:
                tasks[step] = progress.add_task(step, total=total)
            progress.update(tasks[step], completed=done, total=total)

        if kernels:
            from dslab.experiments.kernels import compile_kernels

            compile_kernels(show)
        yield show


def parse_seeds(text: str) -> list[int]:
    """Parse one seed or a range of seeds, such as 7 or 1-10. Raises InputError."""
    from dslab.scenarios.errors import InputError

    first, _, last = text.partition("-")
    if not first.isdecimal() or ("-" in text and not last.isdecimal()) or int(last or first) < int(first):
        raise InputError(f"--seeds {text}", "is no seed or range of seeds", "write it as 7 or 1-10")
    return list(range(int(first), int(last or first) + 1))


def print_table(table: Table) -> None:
    """Print a table without frame; words too long for a narrow terminal are folded, never cut."""
    table.box, table.show_edge, table.pad_edge, table.title_justify = box.SIMPLE_HEAD, False, False, "left"
    for column in table.columns:
        column.overflow = "fold"
    out.print(table)


def print_error_line(line: str) -> None:
    """Print one unwrapped line on stderr, whatever the names in it hold."""
    err.print(line.replace("\n", " "), soft_wrap=True)


def print_facts(facts: Mapping[str, str]) -> None:
    """Print a line per fact, never cut: names of folders can be copied from it."""
    longest = max(map(len, facts))
    for name, value in facts.items():
        out.print(f"{name:{longest}s}  {value}", soft_wrap=True)


def print_segments(segments: "Iterable[SegmentTruth]") -> None:
    """Print the frames on which each segment acts."""
    for segment in segments:
        span = f"frames {segment.first_frame} to {segment.last_frame}"
        out.print(f"  {segment.kind}: {span if segment.first_frame >= 0 else 'acts on no frame'}")


def print_json_line(value: dict) -> None:
    """Print one unwrapped line of JSON on stdout."""
    print(json.dumps(value, allow_nan=False))


def number(value: float | None, digits: int = 3, unit: str = "") -> str:
    """Figure for a table; a dash for None."""
    if value is None:
        return "-"
    return f"{value:.{digits}f}{unit}"


def share(value: float | None) -> str:
    """Share as a percentage; a dash for None."""
    return "-" if value is None else f"{100 * value:.1f} %"
