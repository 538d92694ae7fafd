"""``dslab bench``."""

from typing import Annotated

import typer
from rich.table import Table

from experiments.cli.console import number, out, print_json_line, progress_bars, single_threaded_opencv
from experiments.cli.run import SystemChoice


def bench_command(
    source: Annotated[
        str, typer.Argument(help="A sequence folder, a scenario's name or its YAML file.")
    ] = "clean-room",
    runs: Annotated[int, typer.Option(min=1, help="How often to run it.")] = 1,
    system: Annotated[SystemChoice, typer.Option(help="The SLAM system.")] = SystemChoice.BASE,
    seed: Annotated[int | None, typer.Option(min=0, help="Root seed.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as one line of JSON.")] = False,
) -> None:
    """Measure the speed of the tracker: CPU milliseconds per stage, frames per second, memory, map size.

    Kernels are compiled before anything is measured.

    For example:

    `dslab bench`

    `dslab bench path/to/sequence --runs 3`
    """
    from experiments.bench import bench
    from experiments.sources import open_sequence

    single_threaded_opencv()
    with progress_bars() as show:
        sequence = open_sequence(source, seed, show)
        figures = bench(sequence, system.value, runs, seed or 0, show)
    if as_json:
        print_json_line(figures)
        return
    table = Table(title=f"{figures['sequence']}, {system}, {runs} run(s), {figures['frames']} frames each")
    for column in ("stage", "median CPU ms", "p95 CPU ms"):
        table.add_column(column, justify="left" if column == "stage" else "right")
    for stage, row in figures["stages"].items():
        table.add_row(stage, number(row["cpu_ms_median"], 2), number(row["cpu_ms_p95"], 2))
    table.add_section()
    table.add_row(
        "tracking, whole frame", number(figures["cpu_ms_median"], 2), number(figures["cpu_ms_p95"], 2)
    )
    table.add_row(
        "mapping, per keyframe",
        number(figures["mapping_cpu_ms_median"], 2),
        number(figures["mapping_cpu_ms_p95"], 2),
    )
    out.print(table)
    out.print(
        f"{number(figures['frames_per_s'], 1)} frames per second in all, "
        f"peak memory {number(figures['peak_rss_mb'], 0)} MiB, "
        f"{figures['keyframes']} keyframes, {figures['map_points']} map points, "
        f"{figures['tracked']} of {figures['frames']} frames tracked"
    )
