"""``dslab bench``."""

from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from typer.core import TyperGroup

from dslab.experiments.cli.bench_direct import direct_command
from dslab.experiments.cli.console import (
    JsonOption,
    ModeChoice,
    ModeOption,
    RealTimeOption,
    RendererOption,
    SourceArgument,
    check_real_time,
    number,
    out,
    print_json_line,
    print_table,
    progress_bars,
    share,
    single_threaded_opencv,
)
from dslab.experiments.cli.run import SystemChoice
from dslab.scenarios.errors import InputError

if TYPE_CHECKING:
    from dslab.slam.dual.config import DualConfig

_HELP = """Measure the speed of the tracker (`slam`), the simulator (`sim`) or whole units (`experiment`).

Or hold photometric alignment against exact depth and pose (`direct`). `dslab batch` compares systems, counts
what they declare falsely and how often recoveries rescue a map.

`dslab bench` and `dslab bench SOURCE` are short for `dslab bench slam`. For example:

`dslab bench`

`dslab bench path/to/sequence --runs 3`

`dslab bench sim`

`dslab bench experiment`

`dslab bench direct`
"""


class _SlamByDefault(TyperGroup):
    """Command group that passes arguments without a command to ``slam``."""

    def parse_args(self, ctx, args: list[str]) -> list[str]:
        if not args or args[0] not in {*self.commands, *ctx.help_option_names}:
            args = ["slam", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(help=_HELP, cls=_SlamByDefault)
app.command("direct")(direct_command)


@app.command("slam")
def slam_command(
    source: SourceArgument = "clean-room",
    runs: Annotated[int, typer.Option(min=1, help="Number of runs.")] = 1,
    system: Annotated[SystemChoice, typer.Option(help="The SLAM system.")] = SystemChoice.BASE,
    seed: Annotated[int | None, typer.Option(min=0, help="Root seed.")] = None,
    renderer: RendererOption = None,
    mode: ModeOption = ModeChoice.LOCKSTEP,
    real_time: RealTimeOption = False,
    no_relocalization: Annotated[
        bool,
        typer.Option(
            "--no-relocalization", help="Do not relocalize in saved maps until a new map is initialized."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Measure the tracker: CPU milliseconds per stage, frames per second, memory, map size.

    Kernels are compiled before the measurement. `dslab batch` compares with other systems. For example:

    `dslab bench slam path/to/sequence --runs 3`

    `dslab bench slam stressed --seed 3 --system dual --no-relocalization --mode threaded --real-time`
    """
    from dslab.experiments.benchmarks.tracker import bench
    from dslab.experiments.runs.files import plain
    from dslab.experiments.runs.sources import open_sequence

    check_real_time(real_time, mode)
    if no_relocalization and system in (SystemChoice.BASE, SystemChoice.DSO):
        raise InputError(
            "--no-relocalization", f"{system.value} never looks for saved maps", "add --system dual"
        )
    single_threaded_opencv()
    with progress_bars() as show:
        sequence = open_sequence(source, seed, show, renderer=renderer)
        figures = bench(
            sequence,
            system.value,
            runs,
            seed or 0,
            show,
            mode=mode.value,
            real_time=real_time,
            dual=_without_relocalization() if no_relocalization else None,
        )
    if as_json:
        print_json_line(plain(figures))
        return
    print_table(_stages_table(figures))
    out.print(
        f"{number(figures['frames_per_s'], 1)} frames per second overall, "
        f"peak memory {number(figures['peak_rss_mb'], 0)} MiB, "
        f"{figures['keyframes']} keyframes, {figures['map_points']} map points, "
        f"{figures['tracked']} of {figures['frames']} frames tracked"
    )
    if real_time:
        out.print(f"frames dropped, run by run: {', '.join(map(str, figures['dropped_frames']))}")
    if figures["fusions"]["beside_frames"]:
        _print_fusions(figures["fusions"])


def _without_relocalization() -> "DualConfig":
    from dslab.slam.dual.config import DualConfig

    return DualConfig(relocalization=False)


def _print_fusions(fusions: dict[str, Any]) -> None:
    out.print(
        f"{fusions['count']} fusions, the longest holds tracking up for "
        f"{number(fusions['hold_up_ms_max'], 1)} ms; dropped beside recovery and fusion: "
        f"{fusions['beside_dropped']} of {fusions['beside_frames'] + fusions['beside_dropped']} frames, "
        f"else {fusions['other_dropped']} of {fusions['other_frames'] + fusions['other_dropped']}"
    )


def _stages_table(figures: dict[str, Any]) -> Table:
    table = Table(
        title=f"{figures['sequence']}, {figures['system']}, {figures['mode']}, "
        f"{figures['runs']} run(s), {figures['frames']} frames each"
    )
    for column in ("stage", "median CPU ms", "p95 CPU ms"):
        table.add_column(column, justify="left" if column == "stage" else "right")
    for stage, row in figures["stages"].items():
        table.add_row(stage, number(row["cpu_ms_median"], 2), number(row["cpu_ms_p95"], 2))
    table.add_section()
    for name, prefix in (
        ("tracking, whole frame", ""),
        ("mapping, per keyframe", "mapping_"),
        ("loop closing, per keyframe", "loop_"),
    ):
        median, p95 = figures[f"{prefix}cpu_ms_median"], figures[f"{prefix}cpu_ms_p95"]
        table.add_row(name, number(median, 2), number(p95, 2))
    return table


@app.command("sim")
def sim_command(
    processes: Annotated[int, typer.Option(min=1, help="Number of rendering processes.")] = 2,
    frames: Annotated[int, typer.Option(min=1, help="Frames per process and figure.")] = 120,
    renderer: RendererOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure the simulator at 640x480: frames per second, building time of a large city, memory.

    Processes start together once all are ready. On a shared machine, use the CPU time per frame. For example:

    `dslab bench sim`
    """
    from dslab.experiments.benchmarks.simulator import bench_sim
    from dslab.sim.rendering.renderers import DEFAULT_RENDERER

    with progress_bars() as show:
        figures = bench_sim(processes, frames, show, renderer or DEFAULT_RENDERER)
    if as_json:
        print_json_line(figures)
        return
    print_table(_rates_table(figures))
    build, targets = figures["build"], figures["asked"]
    out.print(
        f"City of 1 km: built in {number(build['build_s'], 1)} s, {number(build['build_cpu_s'], 1)} s of CPU "
        f"(limit: {number(targets['build_s'], 0)} s), "
        f"then loaded into the renderer in {number(build['load_s'], 1)} s; "
        f"peak memory {number(build['peak_rss_mb'], 0)} MiB"
    )


def _rates_table(figures: dict[str, Any]) -> Table:
    targets = figures["asked"]
    table = Table(
        title=f"{figures['renderer']}, {figures['processes']} processes, "
        f"{'x'.join(map(str, figures['size_px']))}"
    )
    table.add_column("frames")
    for column in ("per\nsecond", "target", "CPU ms\neach", "with a\nfree core\neach", "peak\nMiB", "limit"):
        table.add_column(column, justify="right")
    rows = [
        (f"rendered, {name.replace('_', ' ')}", row, number(targets["rendered_per_s"], 0))
        for name, row in figures["rendered"].items()
    ]
    rows.append(("degraded", figures["degraded"]["sharp"], number(targets["degraded_per_s"], 0)))
    rows.append(("degraded and blurred", figures["degraded"]["blurred"], "-"))
    for name, row, least in rows:
        table.add_row(
            name,
            number(row["frames_per_s"], 1),
            least,
            number(row["cpu_ms"], 1),
            number(row["frames_per_s_alone"], 1),
            number(row["peak_rss_mb"], 0),
            number(targets["peak_rss_mb"], 0),
        )
    return table


@app.command("experiment")
def experiment_command(
    experiment: Annotated[str, typer.Argument(metavar="NAME|SPEC.yaml", help="The experiment.")] = "smoke",
    units: Annotated[int, typer.Option(min=1, help="Units per lap.")] = 4,
    workers: Annotated[int, typer.Option(min=2, help="Workers of the second lap.")] = 2,
    as_json: JsonOption = False,
) -> None:
    """Measure units per hour on one and several workers, and shares of CPU time.

    The cache of rendered sequences is not used. On a shared machine, use the shares of CPU time. For example:

    `dslab bench experiment`

    `dslab bench experiment eq1 --units 8 --workers 4`
    """
    from dslab.experiments.benchmarks.experiment import bench_experiment
    from dslab.experiments.eq1.spec import load_spec
    from dslab.experiments.eq1.trial import run_unit

    with progress_bars() as show:
        figures = bench_experiment(load_spec(experiment), units, workers, run_unit, show)
    if as_json:
        print_json_line(figures)
        return
    table = Table(title=f"{figures['experiment']}, {figures['cores']} cores")
    for column in ("workers", "units", "units per hour", "CPU s each", "render", "SLAM", "overhead"):
        table.add_column(column, justify="right")
    for lap in figures["laps"]:
        shares = (share(lap[f"{part}_share"]) for part in ("render", "slam", "overhead"))
        each = number(lap["cpu_s"] / lap["units"] if lap["units"] else None, 1)
        table.add_row(str(lap["workers"]), str(lap["units"]), number(lap["units_per_hour"], 1), each, *shares)
    print_table(table)
    out.print(
        f"{workers} workers compared with one: {number(figures['speed_up'], 2)} times the units per hour "
        f"({number(figures['speed_up_cores_free'], 2)} with a free core each, by CPU time)"
    )
