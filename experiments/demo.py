"""Demonstration: several systems on one scenario, with a picture and a common recording."""

from collections.abc import Callable
from collections.abc import Sequence as Many
from pathlib import Path

from experiments.evaluation.summary import summarise
from experiments.pictures.run_picture import draw_runs
from experiments.result_folder import RECORDING_FILE, write_run
from experiments.runs.execution import RunRecord, SystemFactory, SystemKind, execute
from experiments.runs.files import to_json
from sim.io.folders import new_directory
from sim.sequence import Sequence

SYSTEMS: tuple[SystemKind, ...] = ("base", "dual+")
MARKER_FILE = "demo.json"
PICTURE_FILE = "demo.png"


def run_demo(
    sequence: Sequence,
    seed: int,
    out_dir: Path,
    progress: Callable[[str, int, int], None] | None = None,
    build: SystemFactory | None = None,
    systems: Many[SystemKind] = SYSTEMS,
) -> dict[SystemKind, dict]:
    """Run the systems and write a folder for each, with a common recording.rrd and demo.png.

    Args:
        sequence: the rendered scenario.
        seed: root seed of the systems.
        out_dir: absent, empty, or an earlier demonstration, which is replaced.
        progress: called with (step, done, total).
        build: factory of the systems; ``slam.factory.build_system`` by default.
        systems: kinds of systems, in display order.

    Returns:
        Summary of each system.

    Raises:
        InputError: the folder is taken or not writable, or the disk is full.
    """
    from experiments.recording import Recording

    show = progress or (lambda step, done, total: None)
    records: dict[SystemKind, RunRecord] = {}
    summaries: dict[SystemKind, dict] = {}
    with new_directory(out_dir, replaces=MARKER_FILE) as folder:
        with Recording(folder / RECORDING_FILE, sequence, systems) as recording:
            for kind in systems:
                records[kind] = execute(
                    sequence,
                    kind,
                    seed,
                    recording.watch(kind),
                    lambda done, total, kind=kind: show(f"SLAM ({kind})", done, total),
                    build,
                )
            recording.finish(list(records.values()))
        for kind, record in records.items():
            own = folder / kind
            own.mkdir()
            summaries[kind] = summarise(record)
            write_run(own, record, summaries[kind])
        draw_runs(folder / PICTURE_FILE, sequence, records)
        (folder / MARKER_FILE).write_text(to_json(summaries, indent=2) + "\n", encoding="utf-8")
    return summaries
