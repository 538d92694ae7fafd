"""Demonstration: base and Dual-SLAM⁺ on one scenario, then some units of an experiment."""

from pathlib import Path

from experiments.result_folder import run_systems
from experiments.runs.execution import SystemFactory, SystemKind
from experiments.runs.files import to_json
from sim.io.folders import Progress, new_directory
from sim.sequence import Sequence

SYSTEMS: tuple[SystemKind, ...] = ("base", "dual+")
MARKER_FILE = "demo.json"


def run_demo(
    sequence: Sequence,
    seed: int,
    out_dir: Path,
    progress: Progress | None = None,
    build: SystemFactory | None = None,
) -> dict[SystemKind, dict]:
    """Run the systems and write a folder for each, with a common recording and picture.

    Args:
        sequence: the rendered scenario.
        seed: root seed of the systems.
        out_dir: absent, empty, or an earlier demonstration, which is replaced.
        progress: called with (step, done, total).
        build: factory of the systems; ``slam.factory.build_system`` by default.

    Returns:
        Summary of each system.

    Raises:
        InputError: the folder is taken or not writable, or the disk is full.
    """
    with new_directory(out_dir, replaces=MARKER_FILE) as folder:
        summaries = run_systems(sequence, SYSTEMS, seed, folder, True, progress, build)
        (folder / MARKER_FILE).write_text(to_json(summaries, indent=2) + "\n", encoding="utf-8")
    return summaries
