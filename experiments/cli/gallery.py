"""``dslab scenarios gallery``."""

from typing import Annotated

import typer

from dslab.experiments.cli.console import FolderOption, out, progress_bars, single_threaded_opencv


def gallery_command(
    out_dir: FolderOption,
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Families, members or .yaml files; default: all of dslab.", metavar="NAME"),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Sequences per scenario, one seed each.")] = 3,
    frames: Annotated[int, typer.Option(min=1, max=100, help="Frames per sequence.")] = 8,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
) -> None:
    """Make a page of scenarios: thumbnails, a map of the path, segments, drawn parameters.

    The folder holds index.html and its pictures; it opens from the disk without a network. For example:

    `dslab scenarios gallery --out out/gallery --workers 2`

    `dslab scenarios gallery kitti-like stressed mine.yaml --seeds 1 --out out/some`
    """
    from dslab.experiments.gallery.build import make_gallery
    from dslab.sim.io.folders import check_free

    check_free(out_dir)
    single_threaded_opencv()
    with progress_bars() as show:
        step = "sequences"
        made = make_gallery(
            names or [], out_dir, seeds, frames, workers, lambda done, total: show(step, done, total)
        )
    megabytes = made.size_bytes / 1e6
    out.print(
        f"{made.page}: {made.scenarios} scenarios, {made.sheets} sequences, {megabytes:.1f} MB",
        soft_wrap=True,
    )
