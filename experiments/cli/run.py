"""``dslab run``."""

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dslab.experiments.cli.console import (
    CameraOption,
    ForceOption,
    ModeChoice,
    ModeOption,
    RealTimeOption,
    RendererOption,
    SystemsOption,
    check_real_time,
    check_seed,
    out,
    print_json_line,
    progress_bars,
    single_threaded_opencv,
)

if TYPE_CHECKING:
    from dslab.experiments.runs.systems.registry import System


class SystemChoice(StrEnum):
    """The systems to choose from."""

    BASE = "base"
    DUAL = "dual"
    DUAL_PLUS = "dual+"
    PAPER = "paper"
    PAPER_PLUS = "paper+"
    DSO = "dso"
    LDSO = "ldso"


def run_command(
    source: Annotated[str, typer.Argument(help="A sequence folder, a scenario's name or its YAML file.")],
    out_dir: Annotated[Path, typer.Option("--out", help="Result folder; absent or empty.")],
    system: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="base: ORB-SLAM's method; dual: Dual-SLAM; dual+: with initialization by GMS; paper and "
            "paper+: these near the paper's text; dso: direct sparse odometry; ldso: that with loops; those "
            "of dslab systems list; a class of your own, as module:Class; or several, such as base,dual.",
        ),
    ] = "base",
    systems_dir: SystemsOption = None,
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
            metavar="KINDS",
            help="Recovery threads of Dual-SLAM in the order in which they are tried, such as orb,sift.",
            show_default=False,
        ),
    ] = None,
    exhaustive: Annotated[
        bool, typer.Option("--exhaustive", help="Run every recovery thread to its end, whatever succeeds.")
    ] = False,
    no_relocalization: Annotated[
        bool,
        typer.Option(
            "--no-relocalization", help="Do not relocalize in saved maps until a new map is initialized."
        ),
    ] = False,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            callback=check_seed,
            metavar="N",
            help="Root seed of the scenario and of the SLAM; the scenario's own, or 0.",
        ),
    ] = None,
    renderer: RendererOption = None,
    camera: CameraOption = None,
    mode: ModeOption = ModeChoice.LOCKSTEP,
    real_time: RealTimeOption = False,
    maps: Annotated[
        bool, typer.Option("--map", help="Write the map too, as a COLMAP model with points.ply.")
    ] = False,
    rerun: Annotated[bool, typer.Option("--rerun", help="Write recording.rrd too.")] = False,
    force: ForceOption = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print each summary as one line of JSON.")] = False,
) -> None:
    """Run SLAM over a sequence folder or a scenario, say what happened, and write the result folder.

    Writes trajectory.txt (TUM), keyframes.txt, frames.csv, events.jsonl, summary.json and trajectory.png; of
    several systems a folder each, with one picture and one recording of all.

    For example:

    `dslab run stressed --system base,dual --out out/stressed`

    `dslab run stressed --system dual --seed 3 --out out/stressed-3 --rerun`

    `dslab run stressed --system dual+ --recovery orb,sift --exhaustive --no-relocalization --out out/lab`

    `dslab run path/to/sequence --config slam.yaml --out out/sequence --json`

    `dslab run clean-room --mode threaded --real-time --map --out out/room`

    `dslab run video.mp4 --camera cam.yaml --system dual --out out/video`

    `dslab run path/to/sequence --system base,orbslam3,my_slam:MySlam --out out/compared`
    """
    from dslab.experiments.cli.run_tables import print_runs
    from dslab.experiments.result_folder import PICTURE_FILE, run_systems
    from dslab.experiments.runs.slam_settings import SlamSettings, factory_of, read_slam_settings
    from dslab.experiments.runs.sources import open_sequence
    from dslab.experiments.runs.systems.registry import Registry, split_names
    from dslab.scenarios.errors import InputError
    from dslab.sim.io.folders import check_free, new_directory
    from dslab.slam.factory import SYSTEMS
    from dslab.slam.warmup import warm_up

    chosen = Registry.open(systems_dir or ()).find_all(split_names(system))
    systems = list(chosen)
    _check_startable(chosen, maps)
    settings = read_slam_settings(config) if config is not None else SlamSettings()
    if config is not None and mode is ModeChoice.LOCKSTEP and settings.mode is not None:
        mode = ModeChoice(settings.mode)
    check_real_time(real_time, mode)
    options = _dual_options([s for s in systems if s in SYSTEMS], recovery, exhaustive, no_relocalization)
    settings = replace(settings, dual_options=options, mode=mode.value)
    if real_time and rerun:
        raise InputError("--rerun", "a recording takes time from the frames", "leave out --real-time")
    check_free(out_dir)
    single_threaded_opencv()
    with progress_bars() as show:
        sequence = open_sequence(source, seed, show, renderer=renderer, force=force, camera=camera)
        if real_time:
            # Compiling and loading kernels would be taken for slowness.
            warm_up(show)
        slam_seed = seed if seed is not None else int(sequence.meta.get("seed", 0))
        build = factory_of(settings)
        with new_directory(out_dir) as folder:
            summaries = run_systems(
                sequence, systems, slam_seed, folder, rerun, show, build, real_time, maps, chosen
            )
    if as_json:
        for summary in summaries.values():
            print_json_line(summary)
    else:
        print_runs(summaries)
        out.print(f"picture    {out_dir / PICTURE_FILE}", soft_wrap=True)
        if rerun:
            out.print(f"recording  dslab view {out_dir}", soft_wrap=True)
        for kind in summaries:
            out.print(f"{kind:10s} {out_dir / kind if len(summaries) > 1 else out_dir}", soft_wrap=True)
    _check_described(summaries)


def _check_startable(chosen: "dict[str, System]", maps: bool) -> None:
    """Check, before frames are rendered, that programs are there, and that maps are asked of ours only."""
    from dslab.experiments.runs.systems.command import CommandSystem
    from dslab.experiments.runs.systems.registry import OwnSystem
    from dslab.scenarios.errors import InputError
    from dslab.slam.factory import DIRECT

    for system in chosen.values():
        if isinstance(system, CommandSystem):
            system.check()
        if maps and (not isinstance(system, OwnSystem) or system.name in DIRECT):
            raise InputError("--map", f"of {system.name} only poses are known", "leave out --map")


def _check_described(summaries: dict[str, dict]) -> None:
    """Raise InputError, after all is written, if a program left other files than described."""
    from dslab.experiments.runs.ending import Ending, EndKind
    from dslab.scenarios.errors import InputError

    for name, summary in summaries.items():
        if Ending(EndKind(summary["ended"])).is_of_description:
            raise InputError(f"system {name}", summary["ended_message"], "correct it, or its description")


def _dual_options(
    systems: list[str], recovery: str | None, exhaustive: bool, no_relocalization: bool
) -> dict[str, Any]:
    """The fields of the settings of Dual-SLAM that options give."""
    from dslab.scenarios.errors import InputError
    from dslab.slam.dual.recovery.registry import parse_threads
    from dslab.slam.factory import DIRECT

    options: dict[str, Any] = {}
    if exhaustive:
        options["exhaustive"] = True
    if no_relocalization:
        options["relocalization"] = False
    if recovery is not None:
        try:
            options["recovery_threads"] = parse_threads(recovery)
        except ValueError as error:
            remedy = "give kinds with commas between, such as orb,sift"
            raise InputError("--recovery", str(error), remedy) from None
    if options and set(systems) <= {"base", *DIRECT}:
        raise InputError("--system", f"{', '.join(systems)}: no recovery", "add --system dual or dual+")
    return options
