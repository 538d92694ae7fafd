"""The demonstration: one stressed scenario through base and Dual-SLAM, with pictures and recordings."""

from collections.abc import Callable
from pathlib import Path

from experiments.demo_picture import draw_demo
from experiments.execution import RunRecord, SystemFactory, SystemKind
from experiments.files import to_json
from experiments.output import new_directory
from experiments.run import RECORDING_FILE, execute_recorded, write_run
from experiments.summary import summarise
from sim.sequence import Sequence

SYSTEMS: tuple[SystemKind, ...] = ("base", "dual")
MARKER_FILE = "demo.json"
PICTURE_FILE = "demo.png"


def run_demo(
    sequence: Sequence,
    seed: int,
    out_dir: Path,
    progress: Callable[[str, int, int], None] | None = None,
    build: SystemFactory | None = None,
) -> dict[SystemKind, dict]:
    """Run both systems and write a folder each, with recording, and demo.png beside them.

    Args:
        sequence: the rendered scenario.
        seed: root seed of both systems.
        out_dir: absent, empty, or an earlier demonstration, which is replaced.
        progress: called with (step, done, total).
        build: makes the systems; ``slam.system.build_system`` by default.

    Returns:
        The summary of each system.

    Raises:
        InputError: the folder is taken or not writable, or the disk is full.
    """
    show = progress or (lambda step, done, total: None)
    records: dict[SystemKind, RunRecord] = {}
    summaries: dict[SystemKind, dict] = {}
    with new_directory(out_dir, replaces_marker=MARKER_FILE) as folder:
        for kind in SYSTEMS:
            own = folder / kind
            own.mkdir()
            records[kind] = execute_recorded(
                sequence,
                kind,
                seed,
                own / RECORDING_FILE,
                lambda done, total, kind=kind: show(f"SLAM ({kind})", done, total),
                build,
            )
            summaries[kind] = summarise(records[kind])
            write_run(own, records[kind], summaries[kind])
        draw_demo(folder / PICTURE_FILE, sequence, records)
        (folder / MARKER_FILE).write_text(to_json(summaries, indent=2) + "\n", encoding="utf-8")
    return summaries
