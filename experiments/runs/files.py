"""The files of a run: TUM trajectories, frames.csv, events.jsonl, summary.json."""

import csv
import json
import math
from collections.abc import Iterable
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.slam.core.events import Event
from dslab.slam.core.results import MapTrajectory, RelativePose, TrackingResult


def write_tum(path: Path, trajectory: MapTrajectory | None) -> None:
    """Write a path as TUM text: ``stamp_s tx ty tz qx qy qz qw``, camera to map, in the map's own scale.

    No trajectory gives a file with the header alone.
    """
    with path.open("w", encoding="utf-8") as file:
        file.write("# stamp_s tx ty tz qx qy qz qw (camera to map, map units)\n")
        if trajectory is None:
            return
        quat_xyzw = Rotation.from_matrix(trajectory.T_map_cam[:, :3, :3]).as_quat()
        for stamp_s, T, q in zip(trajectory.stamps_s, trajectory.T_map_cam, quat_xyzw, strict=True):
            numbers = " ".join(f"{v:.9f}" for v in (*T[:3, 3], *q))
            file.write(f"{stamp_s:.9f} {numbers}\n")


def write_frames_csv(path: Path, results: Iterable[TrackingResult]) -> None:
    """Write one row per frame: its outcome, how well its pose is known, and times.

    ``position_sd`` (map units) and ``direction_sd_deg`` are standard deviations of the pose relative to the
    keyframe of frame ``relative_to``, along the axis in which each is largest; empty where the system tells
    none. Milliseconds are in total and per stage, wall (``ms``) and CPU (``cpu_ms``).
    """
    results = list(results)
    stages = list(dict.fromkeys(stage for r in results for stage in (*r.ms, *r.cpu_ms)))
    header = ["frame", "stamp_s", "state", "map_id", "inliers", "matches", "keyframe", "reason"]
    header += ["relative_to", "position_sd", "direction_sd_deg"]
    header += ["ms", "cpu_ms", "mapping_cpu_ms", "loop_cpu_ms"]
    header += [f"ms_{s}" for s in stages] + [f"cpu_ms_{s}" for s in stages]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for r in results:
            fixed = [r.frame, f"{r.stamp_s:.9f}", str(r.state), r.map_id, r.inliers, r.matches]
            fixed += [int(r.is_keyframe), r.reason, *_deviations(r.relative)]
            times = [sum(r.ms.values()), sum(r.cpu_ms.values()), r.mapping_cpu_ms, r.loop_cpu_ms]
            times += [r.ms.get(s) for s in stages] + [r.cpu_ms.get(s) for s in stages]
            writer.writerow(fixed + ["" if t is None else f"{t:.3f}" for t in times])


def _deviations(pose: RelativePose | None) -> list[int | str]:
    if pose is None:
        return ["", "", ""]
    return [pose.frame, f"{pose.position_sd:.6g}", f"{np.rad2deg(pose.direction_sd_rad):.6g}"]


def write_events(path: Path, events: Iterable[Event]) -> None:
    """Write one JSON object per line and event, in order."""
    with path.open("w", encoding="utf-8") as file:
        for event in events:
            file.write(to_json(event.record()) + "\n")


def to_json(value: Any, indent: int | None = None) -> str:
    """Encode as strict JSON: NumPy numbers as numbers, NaN and infinities as null."""
    return json.dumps(plain(value), indent=indent, allow_nan=False)


def plain(value: Any) -> Any:
    """Convert to dicts, lists and Python scalars; NaN and infinities become None."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Enum):
        return plain(value.value)
    return value if value is None or isinstance(value, bool | int | str) else str(value)
