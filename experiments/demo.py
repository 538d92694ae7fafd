"""Demonstration: three systems under the lab's three stresses, beside some units of an experiment."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event

from dslab.experiments.campaign.folder import read_experiment
from dslab.experiments.campaign.runner import Tally, run_experiment
from dslab.experiments.campaign.workers import unit_workers
from dslab.experiments.eq1.spec import ExperimentSpec
from dslab.experiments.result_folder import run_systems
from dslab.experiments.runs.execution import SystemFactory
from dslab.experiments.runs.files import to_json
from dslab.experiments.statistics.analysis import analyse
from dslab.experiments.statistics.judged import JudgedCell
from dslab.sim.io.folders import Progress, new_directory
from dslab.sim.sequence import Sequence

SYSTEMS: tuple[str, ...] = ("base", "dual+", "ldso")
MARKER_FILE = "demo.json"
EXPERIMENT_DIR = "experiment"


def run_demo(
    sequence: Sequence,
    seed: int,
    out_dir: Path,
    experiment: ExperimentSpec | None = None,
    workers: int = 2,
    progress: Progress | None = None,
    build: SystemFactory | None = None,
) -> tuple[dict[str, dict], list[JudgedCell]]:
    """Run the systems beside the units, and write the folder of the demonstration, whole or not at all.

    It holds a folder for each system, their common recording and picture, and the folder of the experiment.

    Args:
        sequence: the rendered scenario.
        seed: root seed of the systems.
        out_dir: absent, empty, or an earlier demonstration, which is replaced.
        experiment: whose units to run; None for none.
        workers: number of processes for the units.
        progress: called with (step, done, total).
        build: factory of the systems; ``slam.factory.build_system`` by default.

    Returns:
        Summary of each system, and each cell of the experiment, per number of threads.

    Raises:
        InputError: the folder is taken or not writable, or the disk is full.
        MachineError: the processes do not start, or every unit fails.
    """
    ended = Event()
    with new_directory(out_dir, replaces=MARKER_FILE) as folder, ThreadPoolExecutor(1) as beside:
        units = experiment and beside.submit(
            _run_units, experiment, folder / EXPERIMENT_DIR, workers, progress, ended
        )
        try:
            summaries = run_systems(sequence, SYSTEMS, seed, folder, True, progress, build)
            cells = units.result() if units else []
        finally:
            ended.set()
        (folder / MARKER_FILE).write_text(to_json(summaries, indent=2) + "\n", encoding="utf-8")
    return summaries, cells


def _run_units(
    experiment: ExperimentSpec, folder: Path, workers: int, progress: Progress | None, ended: Event
) -> list[JudgedCell]:
    def show(tally: Tally) -> None:
        if ended.is_set():
            raise KeyboardInterrupt
        if progress:
            progress("units", tally.done, tally.total)

    run_experiment(experiment, folder, unit_workers(experiment, workers=workers).open, show=show)
    spec, table = read_experiment(folder)
    return list(analyse(table, len(spec.threads)).cells)
