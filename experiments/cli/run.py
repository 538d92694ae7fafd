"""``dslab run``."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dslab.experiments.cli.console import (
    CameraOption,
    FolderOption,
    ForceOption,
    JsonOption,
    ModeOption,
    NoRelocalizationOption,
    RealTimeOption,
    RendererOption,
    SeedOption,
    SourceArgument,
    SystemsOption,
    TruthFormOption,
    TruthOption,
    check_real_time,
    print_facts,
    print_json_line,
    progress_bars,
    single_threaded_opencv,
)
from dslab.experiments.runs.defaults import MODE, SYSTEM
from dslab.scenarios.errors import InputError

if TYPE_CHECKING:
    from dslab.experiments.runs.systems.registry import System


def run_command(
    source: SourceArgument,
    out_dir: FolderOption,
    system: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="base: ORB-SLAM's method; orbslam: as published; dual: Dual-SLAM; dual+: with "
            "initialization by GMS; paper and paper+: these by the paper's text; dso: direct sparse "
            "odometry; ldso: that with loops; those of dslab systems list; a class of your own, as "
            "module:Class; or several, such as base,dual.",
        ),
    ] = SYSTEM,
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
    no_relocalization: NoRelocalizationOption = False,
    seed: SeedOption = None,
    renderer: RendererOption = None,
    camera: CameraOption = None,
    truth: TruthOption = None,
    truth_form: TruthFormOption = "tum",
    mode: ModeOption = MODE,
    real_time: RealTimeOption = False,
    maps: Annotated[
        bool, typer.Option("--map", help="Write the map too, as a COLMAP model with points.ply.")
    ] = False,
    rerun: Annotated[bool, typer.Option("--rerun", help="Write recording.rrd too.")] = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Run SLAM over a sequence folder or a scenario, say what happened, and write the result folder.

    Writes trajectory.txt (TUM), keyframes.txt, frames.csv, events.jsonl, summary.json and trajectory.png; of
    several systems a folder each, with one picture and one recording of all.

    For example:

    `dslab run stressed --system base,dual --out out/stressed`

    `dslab run video.mp4 --camera cam.yaml --system dual --out out/video`

    `dslab run path/to/sequence --system base,orbslam3,my_slam:MySlam --out out/compared`
    """
    from dslab.experiments.cli.run_tables import print_runs
    from dslab.experiments.result_folder import PICTURE_FILE, run_systems
    from dslab.experiments.runs.slam_settings import SlamSettings, factory_of, read_slam_settings
    from dslab.experiments.runs.sources import open_sequence
    from dslab.experiments.runs.systems.command import LOG_FILE
    from dslab.experiments.runs.systems.registry import Registry, split_names
    from dslab.sim.io.folders import check_free, new_directory
    from dslab.slam.warmup import warm_up

    chosen = Registry.open(systems_dir or ()).find_all(split_names(system))
    _check_startable(chosen, maps)
    settings = read_slam_settings(config) if config is not None else SlamSettings()
    if config is not None and mode == "lockstep":
        mode = settings.mode or mode
    check_real_time(real_time, mode)
    options = _dual_options(chosen, recovery, exhaustive, no_relocalization)
    settings = replace(settings, dual_options=options, mode=mode)
    if real_time and rerun:
        raise InputError("--rerun", "a recording takes time from the frames", "leave out --real-time")
    check_free(out_dir)
    single_threaded_opencv()
    with progress_bars() as show:
        sequence = open_sequence(
            source,
            seed,
            show,
            renderer=renderer,
            force=force,
            camera=camera,
            truth=truth,
            truth_form=truth_form,
        )
        if real_time:
            # Compiling and loading kernels would be taken for slowness.
            warm_up(show)
        slam_seed = seed if seed is not None else int(sequence.meta.get("seed", 0))
        build = factory_of(settings)
        with new_directory(out_dir) as folder:
            summaries = run_systems(
                sequence, list(chosen), slam_seed, folder, rerun, show, build, real_time, maps, chosen
            )
    if as_json:
        for summary in summaries.values():
            print_json_line(summary)
    else:
        print_runs(summaries)
        files = {"picture": out_dir / PICTURE_FILE} | (
            {"recording": f"dslab view {out_dir}"} if rerun else {}
        )
        places = {kind: out_dir / kind if len(summaries) > 1 else out_dir for kind in summaries}
        logs = {f"log of {kind}": log for kind, at in places.items() if (log := at / LOG_FILE).exists()}
        print_facts(files | places | logs)
    _check_described(summaries)


def _check_startable(chosen: "dict[str, System]", maps: bool) -> None:
    """Check, before frames are rendered, that programs are there, and that maps are asked of ours only."""
    from dslab.experiments.runs.systems.registry import OwnSystem, check_startable
    from dslab.slam.factory import DIRECT

    for system in chosen.values():
        check_startable(system)
        if maps and (not isinstance(system, OwnSystem) or system.name in DIRECT):
            raise InputError("--map", f"of {system.name} only poses are known", "leave out --map")


def _check_described(summaries: dict[str, dict]) -> None:
    """Raise InputError, after all is written, if a program left other files than described."""
    from dslab.experiments.runs.ending import Ending, EndKind

    for name, summary in summaries.items():
        if Ending(EndKind(summary["ended"])).is_of_description:
            raise InputError(f"system {name}", summary["ended_message"], "correct it, or its description")


def _dual_options(
    chosen: "dict[str, System]", recovery: str | None, exhaustive: bool, no_relocalization: bool
) -> dict[str, Any]:
    """The fields of the settings of Dual-SLAM that options give."""
    from dslab.slam.dual.recovery.registry import parse_threads
    from dslab.slam.factory import DIRECT, SYSTEMS

    options: dict[str, Any] = {"exhaustive": True} if exhaustive else {}
    options |= {"relocalization": False} if no_relocalization else {}
    if recovery is not None:
        try:
            options["recovery_threads"] = parse_threads(recovery)
        except ValueError as error:
            remedy = "give kinds with commas between, such as orb,sift"
            raise InputError("--recovery", str(error), remedy) from None
    systems = [name for name in chosen if name in SYSTEMS]
    if options and set(systems) <= {"base", *DIRECT}:
        raise InputError("--system", f"{', '.join(systems)}: no recovery", "add --system dual or dual+")
    return options
