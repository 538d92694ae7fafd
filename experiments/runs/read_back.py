"""A run as its result folder has it: everything but frames, features and the poses that were given live."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dslab.experiments.runs.ending import Ending
from dslab.experiments.runs.execution import RunRecord
from dslab.experiments.runs.systems.left_events import read_events
from dslab.experiments.runs.systems.left_files import read_maps
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_given, read_json
from dslab.sim.io.text import check_frames, check_order, read_rows, to_numbers
from dslab.sim.io.truth import half_interval_s, read_tum_poses
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import SegmentTruth, Sequence
from dslab.slam.core.results import MapTrajectory, TrackingResult, TrackingState

_REMEDY = "copy the folder again, or run it again"
_NUMBERS = ["frame", "stamp_s", "map_id", "inliers", "matches", "keyframe"]
_SEGMENT = ("kind", "severity", "start_s", "end_s", "first_frame", "last_frame")
_MAIN = -1  # of the map with most frames the number is not written
_NO_CAMERA = Intrinsics(640, 480, 500.0, 500.0, 319.5, 239.5, 30.0)


def read_record(folder: Path) -> RunRecord:
    """Read what a result folder says of its run.

    The sequence has stamps, truth and segments; it has no frames, and its camera is none.

    Raises:
        InputError: it is no result folder of one run, or a file of it is malformed.
    """
    summary_file = folder / "summary.json"
    summary = read_json(summary_file, dict, "give the result folder of a run")
    results = _read_results(folder / "frames.csv")
    stamps_s = np.array([result.stamp_s for result in results])
    truth = read_tum_poses(folder / "groundtruth.txt", stamps_s, half_interval_s(stamps_s, 30.0))
    sequence = Sequence(
        name=str(summary.get("sequence")),
        camera=_NO_CAMERA,
        stamps_s=stamps_s,
        frames=[],
        T_world_cam=truth,
        depths=None,
        segments=_segments(summary_file, summary.get("segments"), len(results)),
        meta={},
    )
    faults: list[Ending] = []
    events = read_events(folder / "events.jsonl", stamps_s, faults)
    main = read_maps(folder, "trajectory.txt", "tum", sequence, faults) if _has_poses(folder) else ()
    others = read_maps(folder, "trajectory_map*.txt", "tum", sequence, faults)
    if faults:
        raise InputError(str(folder), faults[0].message, _REMEDY)
    return RunRecord(
        sequence=sequence,
        system_kind=str(summary.get("system")),
        seed=0,
        config={},
        results=results,
        events=events,
        trajectories=(*(replace(path, map_id=_MAIN) for path in main), *others),
        keyframes=(),
        live={},
        map_points={},
        wall_s=0.0,
        peak_rss_mb=0.0,
    )


def until(record: RunRecord, frame: int) -> RunRecord:
    """The record as far as a frame: its results, its events, and the final poses of the frames so far."""

    def early(paths: tuple[MapTrajectory, ...]) -> tuple[MapTrajectory, ...]:
        cut = [path.where(path.frames <= frame) for path in paths]
        return tuple(sorted((path for path in cut if len(path.frames)), key=lambda path: -len(path.frames)))

    return replace(
        record,
        results=record.results[: frame + 1],
        events=tuple(event for event in record.events if event.frame <= frame),
        trajectories=early(record.trajectories),
    )


def _has_poses(folder: Path) -> bool:
    """Whether there is a map: without one its file has a header alone."""
    path = folder / "trajectory.txt"
    return is_given(path) and next(iter(read_rows(path, "")), None) is not None


def _read_results(path: Path) -> tuple[TrackingResult, ...]:
    rows = read_rows(path, "give the result folder of a run", ",")
    where, header = next(iter(rows), (str(path), []))
    lacking = [name for name in (*_NUMBERS, "state", "reason") if name not in header]
    if lacking:
        raise InputError(where, f"has no column {lacking[0]}", _REMEDY)
    states = {str(state): state for state in TrackingState}
    results: list[TrackingResult] = []
    for where, words in rows:
        row = dict(zip(header, words, strict=False))
        if len(words) != len(header) or row["state"] not in states:
            raise InputError(where, "is no row of a frame", _REMEDY)
        frame, stamp_s, *counts = to_numbers(where, [row[name] for name in _NUMBERS], _NUMBERS)
        if frame != len(results):
            raise InputError(where, f"frame {frame:g} stands where {len(results)} belongs", _REMEDY)
        check_order(where, [result.stamp_s for result in results[-1:]], stamp_s)
        map_id, inliers, matches, keyframe = map(int, counts)
        empty = np.empty((0, 2), np.float32), np.empty(0, bool)
        result = TrackingResult(
            int(frame), stamp_s, states[row["state"]], None, map_id, inliers, matches, row["reason"],
            bool(keyframe), *empty,
        )  # fmt: skip
        results.append(result)
    check_frames(path, results)
    return tuple(results)


def _segments(path: Path, rows: Any, frames: int) -> tuple[SegmentTruth, ...]:
    try:
        return tuple(SegmentTruth.from_record({name: row[name] for name in _SEGMENT}, frames) for row in rows)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: segments", f"are none of a run ({error})", _REMEDY) from None
