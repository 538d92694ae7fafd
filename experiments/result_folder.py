"""One run of one system over one sequence, with its result folder."""

from pathlib import Path

from experiments.evaluation.summary import summarise
from experiments.runs.execution import AtEnd, Progress, RunRecord, SystemFactory, SystemKind, execute
from experiments.runs.files import to_json, write_events, write_frames_csv, write_tum
from experiments.runs.pacing import RealTime
from sim.io.folders import new_directory
from sim.sequence import Sequence

SUMMARY_FILE = "summary.json"
RECORDING_FILE = "recording.rrd"
MAP_DIR = "map"


def run_sequence(
    sequence: Sequence,
    system_kind: SystemKind,
    seed: int,
    out_dir: Path,
    recording: bool = False,
    progress: Progress | None = None,
    build: SystemFactory | None = None,
    pace: RealTime | None = None,
    maps: bool = False,
) -> dict:
    """Run a system and write its result folder, whole or not at all.

    The folder holds trajectory.txt (the map with most frames), trajectory_map<k>.txt (every other map),
    keyframes.txt (of the first), frames.csv, events.jsonl, summary.json and, on request, recording.rrd and
    the maps as COLMAP models in map.

    Args:
        sequence: the input.
        system_kind: ``base``, ``dual`` or ``dual+``.
        seed: root of every random stream of the system.
        out_dir: the result folder, absent or empty.
        recording: write recording.rrd as well.
        progress: called with (frames done, frames in all).
        build: makes the system; ``slam.factory.build_system`` by default.
        pace: feeds in real time; None for as fast as possible.
        maps: write the maps as well.

    Returns:
        The summary, as in summary.json.

    Raises:
        ValueError: a recording is requested in real time, which it would disturb.
        InputError: the folder is taken or not writable, the disk is full, a frame cannot be read.
    """
    with new_directory(Path(out_dir)) as folder:
        record = execute_recorded(
            sequence,
            system_kind,
            seed,
            folder / RECORDING_FILE if recording else None,
            progress,
            build,
            pace,
            _map_writer(folder / MAP_DIR) if maps else None,
        )
        summary = summarise(record)
        write_run(folder, record, summary)
    return summary


def execute_recorded(
    sequence: Sequence,
    system_kind: SystemKind,
    seed: int,
    recording_path: Path | None = None,
    progress: Progress | None = None,
    build: SystemFactory | None = None,
    pace: RealTime | None = None,
    at_end: AtEnd | None = None,
) -> RunRecord:
    """Run a system and, given a path, record it there; arguments as :func:`execute`."""
    if recording_path is None:
        return execute(sequence, system_kind, seed, None, progress, build, pace, at_end)
    if pace is not None:
        raise ValueError("a recording would take time from the frames")
    from experiments.recording import Recording

    with Recording(recording_path, sequence, [system_kind]) as recording:
        watcher = recording.watch(system_kind)
        record = execute(sequence, system_kind, seed, watcher, progress, build, None, at_end)
        recording.finish([record])
    return record


def write_run(folder: Path, record: RunRecord, summary: dict) -> None:
    """Write the files of a run, except the recording, into an existing folder."""
    main = record.trajectories[0] if record.trajectories else None
    write_tum(folder / "trajectory.txt", main)
    for trajectory in record.trajectories[1:]:
        write_tum(folder / f"trajectory_map{trajectory.map_id}.txt", trajectory)
    write_tum(folder / "keyframes.txt", record.keyframes[0] if record.keyframes else None)
    write_frames_csv(folder / "frames.csv", record.results)
    write_events(folder / "events.jsonl", record.events)
    (folder / SUMMARY_FILE).write_text(to_json(summary, indent=2) + "\n", encoding="utf-8")


def _map_writer(folder: Path) -> AtEnd:
    from experiments.runs.map_files import write_maps

    return lambda system, sequence: write_maps(folder, system, sequence)
