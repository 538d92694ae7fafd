"""Result folders: runs of one or several systems over one sequence."""

from collections.abc import Mapping
from collections.abc import Sequence as Many
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.runs.execution import AtEnd, RunRecord, SystemFactory
from dslab.experiments.runs.files import to_json, write_events, write_frames_csv, write_tum
from dslab.experiments.runs.inputs import hashed
from dslab.experiments.runs.pacing import RealTime
from dslab.experiments.runs.systems.command import LOG_FILE
from dslab.experiments.runs.systems.registry import OwnSystem, System
from dslab.experiments.runs.systems.run import run_system
from dslab.sim.io.folders import Progress
from dslab.sim.io.truth import tum_poses_text
from dslab.sim.sequence import Sequence

if TYPE_CHECKING:
    from dslab.experiments.recording import Recording

SUMMARY_FILE = "summary.json"
TRUTH_FILE = "groundtruth.txt"
RECORDING_FILE = "recording.rrd"
PICTURE_FILE = "trajectory.png"
MAP_DIR = "map"


def run_systems(
    sequence: Sequence,
    systems: Many[str],
    seed: int,
    folder: Path,
    recording: bool = False,
    progress: Progress | None = None,
    build: SystemFactory | None = None,
    real_time: bool = False,
    maps: bool = False,
    plugins: Mapping[str, System] | None = None,
) -> dict[str, dict]:
    """Run systems over a sequence, one after the other, and write their results into a folder.

    The folder of a run holds trajectory.txt (the map with most frames), trajectory_map<k>.txt (every other
    map), keyframes.txt (of the first), groundtruth.txt (where there is one), frames.csv, events.jsonl,
    summary.json, trajectory.png and, on request, recording.rrd and the maps as COLMAP models in map. Several
    systems have a folder each, by their names, and in common a trajectory.png and, on request, a
    recording.rrd.

    Args:
        sequence: the input.
        systems: ``base``, ``dual`` or ``dual+``, in the order of display; all different.
        seed: root of every random stream of the systems.
        folder: an existing folder.
        recording: write recording.rrd as well.
        progress: called with (step, frames done, frames in all).
        build: makes the systems; ``slam.factory.build_system`` by default.
        real_time: feed the frames at the pace of their stamps; False for as fast as possible.
        maps: write the maps as well.
        plugins: systems that are not ours, by name. A program leaves its log and its settings in the folder.

    Returns:
        The summary of each system, as in its summary.json.

    Raises:
        ValueError: a recording is requested in real time, which it would disturb.
        InputError: a frame cannot be read, or a program cannot be started.
    """
    if real_time and recording:
        raise ValueError("a recording would take time from the frames")
    sequence = hashed(sequence)
    own = {kind: folder if len(systems) == 1 else folder / kind for kind in systems}
    records: dict[str, RunRecord] = {}
    with _recording(folder / RECORDING_FILE, sequence, systems) if recording else nullcontext() as recorded:
        for kind in systems:
            own[kind].mkdir(exist_ok=True)
            step = f"SLAM ({kind})"
            records[kind] = run_system(
                (plugins or {}).get(kind, OwnSystem(kind)), sequence, seed, build, own[kind],
                observer=recorded and recorded.watch(kind),
                progress=progress and (lambda done, total, step=step: progress(step, done, total)),
                pace=RealTime(sequence) if real_time else None,
                at_end=_map_writer(own[kind] / MAP_DIR) if maps else None,
            )  # fmt: skip
        if recorded is not None:
            recorded.finish(list(records.values()))
    summaries: dict[str, dict] = {kind: summarise(record) for kind, record in records.items()}
    for kind, record in records.items():
        write_run(own[kind], record, summaries[kind])
    if len(systems) > 1:
        _draw(folder, records)
    return summaries


def write_run(folder: Path, record: RunRecord, summary: dict, picture: bool = True) -> None:
    """Write the files of a run, except recording and maps, into an existing folder."""
    main = record.trajectories[0] if record.trajectories else None
    write_tum(folder / "trajectory.txt", main)
    for trajectory in record.trajectories[1:]:
        write_tum(folder / f"trajectory_map{trajectory.map_id}.txt", trajectory)
    write_tum(folder / "keyframes.txt", record.keyframes[0] if record.keyframes else None)
    truth = record.sequence.T_world_cam
    if truth is not None:
        text = tum_poses_text(record.sequence.stamps_s, truth)
        (folder / TRUTH_FILE).write_text(text, encoding="utf-8")
    write_frames_csv(folder / "frames.csv", record.results)
    write_events(folder / "events.jsonl", record.events)
    if record.ending.log:
        (folder / LOG_FILE).write_text(record.ending.log, encoding="utf-8", errors="backslashreplace")
    (folder / SUMMARY_FILE).write_text(to_json(summary, indent=2) + "\n", encoding="utf-8")
    if picture:
        _draw(folder, {record.system_kind: record})


def _draw(folder: Path, records: Mapping[str, RunRecord]) -> None:
    from dslab.experiments.pictures.run_picture import draw_runs

    draw_runs(folder / PICTURE_FILE, records)


def _recording(path: Path, sequence: Sequence, systems: Many[str]) -> "Recording":
    from dslab.experiments.recording import Recording

    return Recording(path, sequence, systems)


def _map_writer(folder: Path) -> AtEnd:
    from dslab.experiments.runs.map_files import write_maps

    return lambda system, sequence: write_maps(folder, system, sequence)
