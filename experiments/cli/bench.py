"""``dslab bench``."""

from typing import Annotated, Any

import typer
from rich.table import Table
from typer.core import TyperGroup

from experiments.cli.console import (
    RendererOption,
    number,
    out,
    print_json_line,
    progress_bars,
    single_threaded_opencv,
)
from experiments.cli.run import SystemChoice

_HELP = """Measure the speed of the tracker, or with `sim` that of the simulator.

`dslab bench` alone and `dslab bench SOURCE` are `dslab bench slam`. For example:

`dslab bench`

`dslab bench path/to/sequence --runs 3`

`dslab bench sim`
"""


class _SlamByDefault(TyperGroup):
    """What names no command goes to ``slam``."""

    def parse_args(self, ctx, args: list[str]) -> list[str]:
        if not args or args[0] not in {*self.commands, *ctx.help_option_names}:
            args = ["slam", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(help=_HELP, cls=_SlamByDefault)


@app.command("slam")
def slam_command(
    source: Annotated[
        str, typer.Argument(help="A sequence folder, a scenario's name or its YAML file.")
    ] = "clean-room",
    runs: Annotated[int, typer.Option(min=1, help="How often to run it.")] = 1,
    system: Annotated[SystemChoice, typer.Option(help="The SLAM system.")] = SystemChoice.BASE,
    seed: Annotated[int | None, typer.Option(min=0, help="Root seed.")] = None,
    renderer: RendererOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as one line of JSON.")] = False,
) -> None:
    """Measure the speed of the tracker: CPU milliseconds per stage, frames per second, memory, map size.

    Kernels are compiled before anything is measured. For example:

    `dslab bench slam path/to/sequence --runs 3`
    """
    from experiments.bench import bench
    from experiments.sources import open_sequence

    single_threaded_opencv()
    with progress_bars() as show:
        sequence = open_sequence(source, seed, show, renderer=renderer)
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


@app.command("sim")
def sim_command(
    processes: Annotated[int, typer.Option(min=1, help="How many render at once.")] = 2,
    frames: Annotated[int, typer.Option(min=1, help="Frames per process and figure.")] = 120,
    renderer: RendererOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as one line of JSON.")] = False,
) -> None:
    """Measure the simulator at 640x480: frames per second, a large city's building time, memory.

    Processes start together once all are ready. Where the machine is shared with other work, look at the
    CPU time of a frame. For example:

    `dslab bench sim`
    """
    from experiments.bench_sim import bench_sim
    from sim.renderers import DEFAULT_RENDERER

    with progress_bars() as show:
        figures = bench_sim(processes, frames, show, renderer or DEFAULT_RENDERER)
    if as_json:
        print_json_line(figures)
        return
    out.print(_rates_table(figures))
    build, asked = figures["build"], figures["asked"]
    out.print(
        f"City of 1 km: built in {number(build['build_s'], 1)} s, {number(build['build_cpu_s'], 1)} s of CPU "
        f"(asked: at most {number(asked['build_s'], 0)} s), "
        f"loaded into the renderer in {number(build['load_s'], 1)} s more; "
        f"peak memory {number(build['peak_rss_mb'], 0)} MiB"
    )


def _rates_table(figures: dict[str, Any]) -> Table:
    asked = figures["asked"]
    table = Table(
        title=f"{figures['renderer']}, {figures['processes']} processes, "
        f"{'x'.join(map(str, figures['size_px']))}"
    )
    table.add_column("frames")
    for column in ("per second", "asked", "CPU ms each", "per second, cores free", "peak MiB", "asked"):
        table.add_column(column, justify="right")
    rows = [
        (f"rendered, {name.replace('_', ' ')}", row, f">= {number(asked['rendered_per_s'], 0)}")
        for name, row in figures["rendered"].items()
    ]
    rows.append(("degraded", figures["degraded"]["sharp"], f">= {number(asked['degraded_per_s'], 0)}"))
    rows.append(("degraded and blurred", figures["degraded"]["blurred"], "-"))
    for name, row, least in rows:
        table.add_row(
            name,
            number(row["frames_per_s"], 1),
            least,
            number(row["cpu_ms"], 1),
            number(row["frames_per_s_alone"], 1),
            number(row["peak_rss_mb"], 0),
            f"<= {number(asked['peak_rss_mb'], 0)}",
        )
    return table
