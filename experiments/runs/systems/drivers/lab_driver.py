"""A system of a commit of this lab over a TUM-form folder, by that commit's own packages.

    python -E -s lab_driver.py SEQUENCE OUT SEED SETTINGS.json

Writes live.txt and frames.csv frame by frame, events.jsonl, and of every map trajectory_<id>.txt and
keyframes_<id>.txt into OUT. It runs in lockstep, in the environment of that commit; -E keeps the packages of
PYTHONPATH away.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TextIO

import cv2
from driver_files import Log, pose_line, quaternion_xyzw

_BELOW = "dslab." if find_spec("dslab") else ""


def main(folder: Path, out: Path, seed: int, settings: dict) -> None:
    """Feed every frame, then save what the system has."""
    cv2.setNumThreads(1)
    sim, slam = import_module(f"{_BELOW}sim"), import_module(f"{_BELOW}slam")
    sequence = sim.load_sequence(folder)
    camera = slam.PinholeCamera(**asdict(sequence.camera))
    system = _factory(slam, settings["config"])(settings["system"], camera, seed)
    log, told = Log(out, "live.txt", "map_id", "mapping_cpu_ms", "loop_cpu_ms"), 0
    with (out / "events.jsonl").open("w", buffering=1) as events:
        for index, stamp_s in enumerate(sequence.stamps_s):
            result = system.process(sequence.frames[index], float(stamp_s))
            times_ms = sum(result.ms.values()), sum(result.cpu_ms.values())
            beside = result.map_id, result.mapping_cpu_ms, result.loop_cpu_ms
            log.frame(stamp_s, str(result.state), *times_ms, *beside)
            if result.state == "tracking" and result.T_map_cam is not None:
                T = result.T_map_cam
                log.pose(stamp_s, T[:3, 3], quaternion_xyzw(T[:3, :3]))
            told = _tell(events, system.events, told)
        system.finish()
        _tell(events, system.events, told)
    log.close()
    for name, paths in (("trajectory", system.trajectories()), ("keyframes", system.keyframe_trajectories())):
        for path in paths:
            poses = zip(path.stamps_s, path.T_map_cam, strict=True)
            lines = [pose_line(stamp_s, T[:3, 3], quaternion_xyzw(T[:3, :3])) for stamp_s, T in poses]
            (out / f"{name}_{path.map_id}.txt").write_text("".join(lines))


def _factory(slam: Any, config: str | None) -> Callable[..., Any]:
    """What makes a system of its name, camera and seed, with the settings in a file."""
    if config is None:
        return slam.build_system
    files = import_module(f"{_BELOW}experiments.runs.slam_settings")
    return files.factory_of(files.read_slam_settings(Path(config)))


def _tell(file: TextIO, events: list, told: int) -> int:
    """Write the events that were not told yet, with what they assert; the number of all."""
    for event in events[told:]:
        row = event.record()
        if getattr(event, "relation", None) is not None:
            row["relation"] = asdict(event.relation)
        file.write(json.dumps(row, default=lambda value: value.tolist()) + "\n")
    return len(events)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), json.loads(Path(sys.argv[4]).read_text()))
