"""``dslab bench``."""

from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from typer.core import TyperGroup

from dslab.experiments.cli.bench_direct import direct_command
from dslab.experiments.cli.bench_recoveries import recoveries_command
from dslab.experiments.cli.console import (
    JsonOption,
    ModeChoice,
    ModeOption,
    RealTimeOption,
    RendererOption,
    SourceArgument,
    SystemsOption,
    check_real_time,
    number,
    out,
    parse_seeds,
    print_json_line,
    print_table,
    progress_bars,
    share,
    single_threaded_opencv,
)
from dslab.experiments.cli.run import SystemChoice, chosen_systems
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_folder

if TYPE_CHECKING:
    import pandas as pd

    from dslab.experiments.runs.systems.registry import System
    from dslab.slam.dual.config import DualConfig

_HELP = """Measure the speed of the tracker (`slam`), the simulator (`sim`) or whole units (`experiment`).

Or count what systems declare falsely over many sequences (`declarations`) and how often recoveries rescue a
map (`recoveries`), compare accuracy (`accuracy`), or hold photometric alignment against exact depth and pose
(`direct`).

`dslab bench` and `dslab bench SOURCE` are short for `dslab bench slam`. For example:

`dslab bench`

`dslab bench path/to/sequence --runs 3`

`dslab bench path/to/sequence --peer orbslam3`

`dslab bench sim`

`dslab bench experiment`

`dslab bench direct`

`dslab bench declarations aliased/room --seeds 1-5 --out out/aliased`

`dslab bench recoveries stressed --seeds 1-5 --out out/rescued`
"""
_RUNS, _RUNS_WITH_PEER = 1, 5


class _SlamByDefault(TyperGroup):
    """Command group that passes arguments without a command to ``slam``."""

    def parse_args(self, ctx, args: list[str]) -> list[str]:
        if not args or args[0] not in {*self.commands, *ctx.help_option_names}:
            args = ["slam", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(help=_HELP, cls=_SlamByDefault)
app.command("direct")(direct_command)
app.command("recoveries")(recoveries_command)


@app.command("slam")
def slam_command(
    source: SourceArgument = "clean-room",
    runs: Annotated[
        int | None,
        typer.Option(min=1, help="Number of runs; default: 1, with a peer 5.", show_default=False),
    ] = None,
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
    peer: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Another system, run in turn with ours: one of dslab systems list."
        ),
    ] = None,
    systems_dir: SystemsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure the tracker: CPU milliseconds per stage, frames per second, memory, map size.

    Kernels are compiled before the measurement. With `--peer`, both systems are compared on the same frames:
    tracking CPU per frame, ATE, share of frames tracked. For example:

    `dslab bench slam path/to/sequence --runs 3`

    `dslab bench slam clean-room --seed 1 --peer orbslam3`

    `dslab bench slam stressed --seed 3 --system dual --no-relocalization --mode threaded --real-time`
    """
    from dslab.experiments.benchmarks.tracker import bench
    from dslab.experiments.runs.files import plain
    from dslab.experiments.runs.sources import open_sequence
    from dslab.experiments.runs.systems.run import ended_well, run_system

    check_real_time(real_time, mode)
    if no_relocalization and system in (SystemChoice.BASE, SystemChoice.DSO):
        raise InputError(
            "--no-relocalization", f"{system.value} never looks for saved maps", "add --system dual"
        )
    other = _peer(peer, systems_dir)
    runs = runs or (_RUNS if other is None else _RUNS_WITH_PEER)
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
            peer=None if other is None else lambda: ended_well(run_system(other, sequence, seed or 0)),
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
    if "comparison" in figures:
        print_table(_comparison_table(figures["comparison"], figures["runs"]))
        for reason in figures["comparison"]["ate_reasons"]:
            out.print(f"a run without ATE: {reason}")


def _peer(name: str | None, systems_dir: list[Path] | None) -> "System | None":
    """The system of a name, checked that it can be started."""
    from dslab.experiments.runs.systems.command import CommandSystem
    from dslab.experiments.runs.systems.registry import Registry

    system = None if name is None else Registry.open(systems_dir or ()).find(name)
    if isinstance(system, CommandSystem):
        system.check()
    return system


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


def _comparison_table(comparison: dict[str, Any], runs: int) -> Table:
    table = Table(title=f"against the peer, medians over {runs} run(s) each, in turn")
    table.add_column("figure")
    for column in ("ours", "peer", "ratio"):
        table.add_column(column, justify="right")
    rows = (
        ("tracking CPU ms per frame", "cpu_ms_median", lambda value: number(value, 2)),
        ("ATE m (RMSE, Sim(3))", "ate_m", lambda value: number(value, 4)),
        ("frames tracked live", "share_tracked", share),
        ("frames with a final pose", "share_with_pose", share),
        ("first tracked frame", "first_tracked_frame", lambda value: number(value, 0)),
    )
    for name, figure, shown in rows:
        ratio = number(comparison["ratio"][figure], 3)
        table.add_row(name, shown(comparison["ours"][figure]), shown(comparison["peer"][figure]), ratio)
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


@app.command("declarations")
def declarations_command(
    scenarios: Annotated[list[str], typer.Argument(metavar="SCENARIO...", help="Names or files.")],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder of the rows; resumed if it exists.")],
    seeds: Annotated[str, typer.Option(help="Seeds of each scenario, such as 7 or 1-10.")] = "1-5",
    system: Annotated[str, typer.Option(help="Systems, separated by commas.")] = "base,dual",
    workers: Annotated[int, typer.Option(min=1, help="Number of processes.")] = 1,
    as_json: JsonOption = False,
) -> None:
    """Count false loops, relocalizations, joins and fusions over sequences with ground truth.

    Each is judged by the truth at the moment it is declared. Stopped and started again, it goes on where it
    was. For example:

    `dslab bench declarations aliased/room aliased/city --seeds 1-10 --workers 2 --out out/aliased`
    """
    from dslab.experiments.benchmarks.declarations import COUNTS, measure_declarations

    systems = chosen_systems(system)
    single_threaded_opencv()
    with progress_bars() as show:
        rows = measure_declarations(scenarios, parse_seeds(seeds), systems, out_dir, workers, show)
    figures = ("runs", *(f"{part}{name}" for name in COUNTS for part in ("", "false_")), "unjudged")
    rows["runs"] = 1
    sums = rows.groupby(["scenario", "system"])[list(figures)].sum()
    if as_json:
        print_json_line(sums.reset_index().to_dict("records"))
        return
    table = Table(title="declared, of which false")
    for column in ("scenario", "system", "runs", *COUNTS, "not judged", "median ATE m"):
        table.add_column(column, justify="left" if column in ("scenario", "system") else "right")
    for _, row in sums.reset_index().iterrows():
        own = rows[(rows.scenario == row.scenario) & (rows.system == row.system)]
        counts = (f"{row[name]} / {row[f'false_{name}']}" for name in COUNTS)
        ate = number(own.ate_m.median(), 3)
        table.add_row(row.scenario, row.system, str(row.runs), *counts, str(row.unjudged), ate)
    print_table(table)


@app.command("accuracy")
def accuracy_command(
    sources: Annotated[list[str], typer.Argument(metavar="SOURCE...", help="Scenarios or folders.")],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder of the rows; resumed if it exists.")],
    seeds: Annotated[
        str, typer.Option(help="Seeds of each source, such as 7 or 1-10; of a folder, places to start.")
    ] = "1-5",
    system: Annotated[SystemChoice, typer.Option(help="Our system.")] = SystemChoice.BASE,
    peer: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Another system for the same frames: one of dslab systems list."),
    ] = None,
    systems_dir: SystemsOption = None,
    peer_runs: Annotated[int, typer.Option(min=1, help="Runs of the peer per sequence.")] = 3,
    skip_frames: Annotated[
        int, typer.Option(min=1, help="Frames that each further seed leaves out of a folder's beginning.")
    ] = 20,
    as_json: JsonOption = False,
) -> None:
    """Compare accuracy and scale drift with a peer's over many sequences.

    ATE is of the frames that both have placed. Stopped and started again, it goes on where it was. A peer in
    real time needs a quiet machine. For example:

    `dslab bench accuracy clean-room path/to/sequence --peer orbslam3 --out out/accuracy`
    """
    from dslab.experiments.benchmarks.accuracy import measure_accuracy, sums
    from dslab.experiments.runs.files import plain

    other = _peer(peer, systems_dir)
    single_threaded_opencv()
    with progress_bars() as show:
        rows = measure_accuracy(
            sources, parse_seeds(seeds), system.value, out_dir, other, peer_runs, skip_frames, show
        )
    found = sums(rows)
    if as_json:
        print_json_line(plain(found.to_dict("records")))
        return
    accuracy = {
        "ours_ate_m": "ATE m", "peer_ate_m": "peer's", "ratio": "ratio", "worst_ratio": "worst ratio",
    }  # fmt: skip
    rest = {
        "ours_scale_off": "scale off", "peer_scale_off": "peer's", "cpu_ratio": "CPU ratio",
        "ours_posed": "posed", "peer_posed": "peer's",
    }  # fmt: skip
    _print_sums(f"{system.value} and peer, medians over sequences", found, accuracy)
    _print_sums("scale, CPU of tracking per frame, share of frames", found, rest)


def _print_sums(title: str, found: "pd.DataFrame", columns: dict[str, str]) -> None:
    """Print some columns of the sums per source, under these headings."""
    table = Table(title=title)
    for heading in ("source", "sequences", *columns.values()):
        table.add_column(heading, justify="left" if heading == "source" else "right")
    for _, row in found.iterrows():
        source = Path(row.source).name if is_folder(Path(row.source)) else row.source
        figures = (number(None if isnan(row[column]) else row[column]) for column in columns)
        table.add_row(source, str(row.sequences), *figures)
    print_table(table)
