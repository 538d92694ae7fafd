"""``dslab run``."""

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from experiments.cli.console import (
    MOST_SEED,
    ForceOption,
    ModeChoice,
    ModeOption,
    RealTimeOption,
    RendererOption,
    check_real_time,
    number,
    out,
    print_json_line,
    progress_bars,
    share,
    single_threaded_opencv,
)

if TYPE_CHECKING:
    from slam.dual.config import DualConfig


class SystemChoice(StrEnum):
    """The systems to choose from."""

    BASE = "base"
    DUAL = "dual"
    DUAL_PLUS = "dual+"


def run_command(
    source: Annotated[str, typer.Argument(help="A sequence folder, a scenario's name or its YAML file.")],
    out_dir: Annotated[Path, typer.Option("--out", help="Result folder; absent or empty.")],
    system: Annotated[
        SystemChoice,
        typer.Option(help="ORB-SLAM's method; Dual-SLAM; Dual-SLAM with initialisation by GMS."),
    ] = SystemChoice.BASE,
    config: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Settings of the SLAM: a YAML file (see dslab config show) or a run's summary.json.",
            show_default=False,
        ),
    ] = None,
    recovery: Annotated[
        str | None,
        typer.Option(
            help="Recovery threads of Dual-SLAM in the order in which they are tried, such as orb,sift.",
            show_default=False,
        ),
    ] = None,
    exhaustive: Annotated[
        bool, typer.Option("--exhaustive", help="Run every recovery thread to its end, whatever succeeds.")
    ] = False,
    relocalization: Annotated[
        bool,
        typer.Option(help="Relocalize frames in saved maps until a new map is initialized."),
    ] = True,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0, max=MOST_SEED, help="Root seed of the scenario and of the SLAM; the scenario's own, or 0."
        ),
    ] = None,
    renderer: RendererOption = None,
    mode: ModeOption = ModeChoice.LOCKSTEP,
    real_time: RealTimeOption = False,
    maps: Annotated[
        bool, typer.Option("--map", help="Write the map too, as a COLMAP model with points.ply.")
    ] = False,
    rerun: Annotated[bool, typer.Option("--rerun", help="Write recording.rrd too.")] = False,
    force: ForceOption = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as one line of JSON.")] = False,
) -> None:
    """Run SLAM over a sequence folder or a scenario and write its result folder.

    Writes trajectory.txt (TUM), keyframes.txt, frames.csv, events.jsonl and summary.json.

    For example:

    `dslab run stressed --system dual --seed 3 --out out/stressed-3 --rerun`

    `dslab run stressed --system dual+ --recovery orb,sift --exhaustive --no-relocalization --out out/lab`

    `dslab run path/to/sequence --config slam.yaml --out out/sequence --json`

    `dslab run clean-room --mode threaded --real-time --map --out out/room`
    """
    from experiments.result_folder import run_sequence
    from experiments.runs.pacing import RealTime
    from experiments.runs.slam_settings import SlamSettings, factory_of, read_slam_settings
    from experiments.runs.sources import open_sequence
    from scenarios.errors import InputError
    from sim.io.folders import check_free
    from slam.warmup import warm_up

    settings = read_slam_settings(config) if config is not None else SlamSettings({})
    if config is not None and mode is ModeChoice.LOCKSTEP and settings.mode is not None:
        mode = ModeChoice(settings.mode)
    check_real_time(real_time, mode)
    dual = _dual_config(system, recovery, exhaustive, relocalization, settings.dual)
    settings = replace(settings, dual=dual, mode=mode.value)
    if real_time and rerun:
        raise InputError("--rerun", "a recording takes time from the frames", "leave out --real-time")
    check_free(out_dir)
    single_threaded_opencv()
    with progress_bars() as show:
        sequence = open_sequence(source, seed, show, renderer=renderer, force=force)
        if real_time:
            # Compiling and loading kernels would be taken for slowness.
            warm_up(show)
        slam_seed = seed if seed is not None else int(sequence.meta.get("seed", 0))
        summary = run_sequence(
            sequence,
            system.value,
            slam_seed,
            out_dir,
            recording=rerun,
            progress=lambda done, total: show(f"SLAM ({system})", done, total),
            build=factory_of(settings),
            pace=RealTime(sequence) if real_time else None,
            maps=maps,
        )
    if as_json:
        print_json_line(summary)
        return
    out.print(summary_table(summary))
    out.print(f"files in {out_dir}" + (f"; open it: dslab view {out_dir}" if rerun else ""), soft_wrap=True)


def _dual_config(
    system: SystemChoice,
    recovery: str | None,
    exhaustive: bool,
    relocalization: bool,
    from_file: "DualConfig | None",
) -> "DualConfig | None":
    """The settings of Dual-SLAM that file and options give, None for its defaults."""
    from scenarios.errors import InputError
    from slam.dual.config import DualConfig
    from slam.dual.recovery.registry import parse_threads

    if recovery is None and not exhaustive and relocalization:
        return from_file
    if system is SystemChoice.BASE:
        raise InputError("--system", "base has no recovery", "add --system dual or dual+")
    given = from_file or DualConfig()
    config = replace(
        given,
        exhaustive=exhaustive or given.exhaustive,
        relocalization=relocalization and given.relocalization,
    )
    if recovery is None:
        return config
    try:
        return replace(config, threads=parse_threads(recovery))
    except ValueError as error:
        raise InputError(
            "--recovery", str(error), "give kinds with commas between, such as orb,sift"
        ) from None


def summary_table(summary: dict) -> Table:
    """The main figures of a run."""
    table = Table(
        title=f"{summary['sequence']}, {summary['system']}, seed {summary['seed']}", show_header=False
    )
    if summary["dropped_frames"]:
        dropped = {"frames dropped, too late": str(summary["dropped_frames"])}
    else:
        dropped = {}
    rows = dropped | {
        "frames tracked": f"{summary['tracked']} of {summary['frames']} ({share(summary['share_tracked'])})",
        "first tracked frame": str(summary["first_tracked_frame"]),
        "maps / keyframes / points": f"{summary['maps']} / {summary['keyframes']} / {summary['map_points']}",
        "breakages / recovered / relocalized": f"{summary['breakages']} / {summary['recoveries']} / "
        f"{summary['relocalizations']}",
        "ATE (RMSE, Sim(3))": _ate(summary),
        "path covered": f"{number(summary['path_m'], 2, ' m')} ({share(summary['path_share'])})",
        "tracking CPU, median / p95": f"{number(summary['cpu_ms_median'], 1)} / "
        f"{number(summary['cpu_ms_p95'], 1)} ms per frame",
        "mapping CPU, median / p95": f"{number(summary['mapping_cpu_ms_median'], 1)} / "
        f"{number(summary['mapping_cpu_ms_p95'], 1)} ms per keyframe",
        "peak memory": number(summary["peak_rss_mb"], 0, " MiB"),
    }
    for name, value in rows.items():
        table.add_row(name, value)
    return table


def _ate(summary: dict) -> str:
    if summary["ate_m"] is None:
        return f"- ({summary['ate_reason']})"
    return (
        f"{summary['ate_m']:.4f} m, {share(summary['ate_share_of_path'])} of the path, "
        f"over {summary['ate_poses']} frames"
    )
