"""``dslab bench direct``."""

from typing import Annotated, Any

import typer
from rich.table import Table

from dslab.experiments.cli.console import (
    JsonOption,
    number,
    parse_seeds,
    print_json_line,
    print_table,
    progress_bars,
    single_threaded_opencv,
)


def direct_command(
    seeds: Annotated[str, typer.Option(help="Seeds of the worlds, such as 7 or 1-10.")] = "301-302",
    as_json: JsonOption = False,
) -> None:
    """Hold photometric alignment against exact depth and pose, over rendered frames one to ten apart.

    In five worlds, at 640x480: errors of the motion; how far a guess may be turned for it to be found; CPU
    time of the steps of the direct thread; memory of the images that are held for it. A minute per seed. For
    example:

    `dslab bench direct --seeds 301-302`
    """
    from dslab.experiments.benchmarks.direct import bench_direct

    single_threaded_opencv()
    with progress_bars() as show:
        figures = bench_direct(parse_seeds(seeds), show)
    if as_json:
        print_json_line(figures)
        return
    print_table(_errors_table(figures))
    print_table(_cpu_table(figures))


def _errors_table(figures: dict[str, Any]) -> Table:
    asked = figures["asked"]
    table = Table(
        title=f"errors of alignment; asked of the medians: {100 * asked['translation_share']:g} % of the "
        f"depth, {asked['rotation_deg']:g} degrees"
    )
    table.add_column("world")
    for column in (
        "pairs",
        "missed",
        "median shift\n% of depth",
        "median turn\ndeg",
        "basin\npx",
        "basin\ndeg",
        "held for 10 s\nMB",
    ):
        table.add_column(column, justify="right")
    for world, row in {**figures["worlds"], "all": figures["all"]}.items():
        shift = row["translation_share_median"]
        table.add_row(
            world,
            str(row["pairs"]),
            str(row["missed"]),
            number(None if shift is None else 100 * shift, 4),
            number(row["rotation_deg_median"], 4),
            number(row["basin_px"], 0),
            number(row["basin_deg"], 1),
            number(figures["held_mb"].get(world), 0),
        )
    return table


def _cpu_table(figures: dict[str, Any]) -> Table:
    table = Table(title="CPU, 640x480, 1,500 points")
    table.add_column("step")
    table.add_column("median CPU ms", justify="right")
    for step, cpu_ms in figures["cpu_ms"].items():
        table.add_row(step, number(cpu_ms, 1))
    return table
