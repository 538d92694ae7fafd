"""``dslab scenarios gallery``: a page that shows scenarios."""

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.console import out, progress_bars, single_threaded_opencv


def gallery_command(
    out_dir: Annotated[Path, typer.Option("--out", help="Folder to make; absent or empty.")],
    names: Annotated[
        list[str] | None,
        typer.Argument(
            help="Families, members or .yaml files; all that come with dslab by default.", metavar="[NAME]..."
        ),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Sequences of each, one seed each.")] = 3,
    frames: Annotated[int, typer.Option(min=1, max=100, help="Frames of each sequence.")] = 8,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
) -> None:
    """Make a page of every scenario: thumbnails, a map of the path, segments, what varies and how.

    The folder holds index.html and its pictures, needs no network and opens from the disk. For example:

    `dslab scenarios gallery --out out/gallery --workers 2`

    `dslab scenarios gallery kitti-like stressed mine.yaml --seeds 1 --out out/some`
    """
    from experiments.gallery.build import make_gallery
    from sim.io.folders import check_free

    check_free(out_dir)
    single_threaded_opencv()
    with progress_bars() as show:
        step = "looking at sequences"
        made = make_gallery(
            names or [], out_dir, seeds, frames, workers, lambda done, total: show(step, done, total)
        )
    megabytes = made.size_bytes / 1e6
    out.print(
        f"{made.page}: {made.scenarios} scenarios, {made.sheets} sequences, {megabytes:.1f} MB",
        soft_wrap=True,
    )
