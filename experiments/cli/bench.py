"""``dslab bench``."""

from collections.abc import Iterator
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from dslab.experiments.cli.console import (
    JsonOption,
    ModeOption,
    NoRelocalizationOption,
    RealTimeOption,
    RendererOption,
    SeedOption,
    SourceArgument,
    SystemName,
    check_real_time,
    number,
    out,
    print_json_line,
    print_rows,
    progress_bars,
    share,
    single_threaded_opencv,
)
from dslab.scenarios.errors import InputError

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


@app.command("direct")
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
        figures = bench_direct(_seeds(seeds), show)
    if as_json:
        print_json_line(figures)
        return
    asked = figures["asked"]
    print_rows(
        (
            {
                "world": world,
                "pairs": row["pairs"],
                "missed": row["missed"],
                "median shift\nshare of depth": number(row["translation_share_median"], 6),
                "median turn\ndeg": number(row["rotation_deg_median"], 4),
                "basin\npx": number(row["basin_px"], 0),
                "basin\ndeg": number(row["basin_deg"], 1),
                "held for 10 s\nMB": number(figures["held_mb"].get(world), 0),
            }
            for world, row in {**figures["worlds"], "all": figures["all"]}.items()
        ),
        f"errors of alignment; asked of the medians: {asked['translation_share']:g} of the depth, "
        f"{asked['rotation_deg']:g} degrees",
    )
    steps = ({"step": step, "median CPU ms": number(ms, 1)} for step, ms in figures["cpu_ms"].items())
    print_rows(steps, "CPU, 640x480, 1,500 points")


def _seeds(text: str) -> list[int]:
    """One seed or a range of seeds, such as 7 or 1-10."""
    first, _, last = text.partition("-")
    if not first.isdecimal() or ("-" in text and not last.isdecimal()) or int(last or first) < int(first):
        raise InputError(f"--seeds {text}", "is no seed or range of seeds", "write it as 7 or 1-10")
    return list(range(int(first), int(last or first) + 1))


@app.command("slam")
def slam_command(
    source: SourceArgument = "clean-room",
    runs: Annotated[int, typer.Option(min=1, help="Number of runs.")] = 1,
    system: Annotated[SystemName, typer.Option(help="The SLAM system.")] = "base",
    seed: SeedOption = None,
    renderer: RendererOption = None,
    mode: ModeOption = "lockstep",
    real_time: RealTimeOption = False,
    no_relocalization: NoRelocalizationOption = False,
    as_json: JsonOption = False,
) -> None:
    """Measure the tracker: CPU milliseconds per stage, frames per second, memory, map size.

    Kernels are compiled before the measurement. `dslab batch` compares with other systems. For example:

    `dslab bench slam path/to/sequence --runs 3`

    `dslab bench slam stressed --seed 3 --system dual --no-relocalization --mode threaded --real-time`
    """
    from dslab.experiments.benchmarks.tracker import bench
    from dslab.experiments.runs.sources import open_sequence
    from dslab.slam.dual.config import DualConfig

    check_real_time(real_time, mode)
    if no_relocalization and system in ("base", "dso"):
        raise InputError("--no-relocalization", f"{system} never looks for saved maps", "add --system dual")
    single_threaded_opencv()
    with progress_bars() as show:
        sequence = open_sequence(source, seed, show, renderer=renderer)
        dual = DualConfig(relocalization=False) if no_relocalization else None
        figures = bench(
            sequence, system, runs, seed or 0, show, mode=mode, real_time=real_time, dual=dual
        )  # fmt: skip
    if as_json:
        print_json_line(figures)
        return
    print_rows(
        _stages(figures),
        f"{figures['sequence']}, {figures['system']}, {figures['mode']}, {figures['runs']} run(s), "
        f"{figures['frames']} frames each",
    )
    out.print(
        f"{number(figures['frames_per_s'], 1)} frames per second overall, "
        f"peak memory {number(figures['peak_rss_mb'], 0)} MiB, "
        f"{figures['keyframes']} keyframes, {figures['map_points']} map points, "
        f"{figures['tracked']} of {figures['frames']} frames tracked"
    )
    if real_time:
        out.print(f"frames dropped, run by run: {', '.join(map(str, figures['dropped_frames']))}")
    fusions = figures["fusions"]
    if fusions["beside_frames"]:
        out.print(
            f"{fusions['count']} fusions, the longest holds tracking up for "
            f"{number(fusions['hold_up_ms_max'], 1)} ms; dropped beside recovery and fusion: "
            f"{fusions['beside_dropped']} of {fusions['beside_frames'] + fusions['beside_dropped']} frames, "
            f"else {fusions['other_dropped']} of {fusions['other_frames'] + fusions['other_dropped']}"
        )


def _stages(figures: dict[str, Any]) -> Iterator[dict[str, str]]:
    whole = {
        "tracking, whole frame": "",
        "mapping, per keyframe": "mapping_",
        "loop closing, per keyframe": "loop_",
    }
    totals = {
        name: {of: figures[f"{prefix}{of}"] for of in ("cpu_ms_median", "cpu_ms_p95")}
        for name, prefix in whole.items()
    }
    for rows in (figures["stages"], totals):
        for name, row in rows.items():
            median, p95 = number(row["cpu_ms_median"], 2), number(row["cpu_ms_p95"], 2)
            yield {"stage": name, "median CPU ms": median, "p95 CPU ms": p95}
        yield {}


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
    build, asked, size = figures["build"], figures["asked"], figures["size_px"]
    rates = {f"rendered, {name.replace('_', ' ')}": row for name, row in figures["rendered"].items()}
    rates |= {"degraded": figures["degraded"]["sharp"], "degraded, blurred": figures["degraded"]["blurred"]}
    limits = {"degraded": asked["degraded_per_s"], "degraded, blurred": None}
    print_rows(
        (
            {
                "frames": name,
                "per\nsecond": number(row["frames_per_s"], 1),
                "asked": number(limits.get(name, asked["rendered_per_s"]), 0),
                "CPU ms\neach": number(row["cpu_ms"], 1),
                "with a\nfree core\neach": number(row["frames_per_s_alone"], 1),
                "peak\nMiB": number(row["peak_rss_mb"], 0),
                "at most": number(asked["peak_rss_mb"], 0),
            }
            for name, row in rates.items()
        ),
        f"{figures['renderer']}, {figures['processes']} processes, {'x'.join(map(str, size))}",
    )
    out.print(
        f"City of 1 km: built in {number(build['build_s'], 1)} s, {number(build['build_cpu_s'], 1)} s of CPU "
        f"(limit: {number(asked['build_s'], 0)} s), "
        f"then loaded into the renderer in {number(build['load_s'], 1)} s; "
        f"peak memory {number(build['peak_rss_mb'], 0)} MiB"
    )


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
    print_rows(
        (
            {
                "workers": lap["workers"],
                "units": lap["units"],
                "units per hour": number(lap["units_per_hour"], 1),
                "CPU s each": number(lap["cpu_s"] / lap["units"] if lap["units"] else None, 1),
                **{part: share(lap[f"{part}_share"]) for part in ("render", "slam", "overhead")},
            }
            for lap in figures["laps"]
        ),
        f"{figures['experiment']}, {figures['cores']} cores",
    )
    out.print(
        f"{workers} workers compared with one: {number(figures['speed_up'], 2)} times the units per hour "
        f"({number(figures['speed_up_cores_free'], 2)} with a free core each, by CPU time)"
    )
