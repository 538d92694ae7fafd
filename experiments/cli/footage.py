"""``dslab footage``."""

from typing import Annotated, Any

import typer
from rich.table import Table

from dslab.experiments.cli.console import (
    FolderOption,
    JsonOption,
    check_seed,
    out,
    print_json_line,
    print_table,
    progress_bars,
    single_threaded_opencv,
)


def footage_command(
    sources: Annotated[
        list[str],
        typer.Argument(
            help="Sequence folders, scenarios' names or their YAML files; the first is the reference.",
            metavar="SOURCE...",
        ),
    ],
    out_dir: FolderOption,
    seed: Annotated[
        int | None,
        typer.Option(min=0, callback=check_seed, metavar="N", help="Root seed of scenarios and system."),
    ] = None,
    frames: Annotated[
        int | None, typer.Option(min=10, metavar="N", help="Only the first N frames of each sequence.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare sequences in what the tracker meets: matches, residuals, tracks, images.

    Runs the base over each and writes index.html with the distributions, and footage.json. It holds
    statistics only, no frame. For example:

    `dslab footage path/to/drive real/drive kitti-like/03 --out out/drives`
    """
    from dslab.experiments.realism.compare import PAGE_FILE, compare_footage

    single_threaded_opencv()
    with progress_bars() as show:
        content = compare_footage(sources, out_dir, seed, frames, show)
    if as_json:
        print_json_line(content)
        return
    print_table(_table(content))
    out.print(f"{out_dir / PAGE_FILE}: medians; in brackets distances of distributions", soft_wrap=True)


def _table(content: dict[str, Any]) -> Table:
    table = Table()
    for name in ("measure", *(sequence["name"] for sequence in content["sequences"])):
        table.add_column(name)
    for measure in content["measures"]:
        cells = (_cell(sequence, place) for place, sequence in enumerate(measure["sequences"]))
        table.add_row(measure["name"], *cells)
    return table


def _cell(sequence: dict[str, Any], place: int) -> str:
    median, apart = sequence["quantiles"][2], sequence["distance"]
    if median is None:
        return "-"
    return f"{median:.3g}" + (f" ({apart:.2f})" if place and apart is not None else "")
