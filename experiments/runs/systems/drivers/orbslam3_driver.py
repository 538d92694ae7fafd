"""ORB-SLAM3, monocular, over a TUM-form folder, through the package pyorbslam3.

    python orbslam3_driver.py SEQUENCE OUT VOCABULARY SETTINGS.json

Writes into OUT trajectory.txt and keyframes.txt (final, of the largest map), live.txt (as given, each map in
its own frame), frames.csv. It runs in an environment of its own.
"""

import json
import os
import re
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pyorbslam3  # pyright: ignore[reportMissingImports]
from driver_files import Clock, Frames, Log, quaternion_xyzw

_SETTLE_S = 3.0
"""Time in which mapping and loop closing may end what they have begun."""


def main(sequence: Path, out: Path, vocabulary: str, settings: dict) -> None:
    """Feed every frame, then save what the system has."""
    cv2.setNumThreads(1)
    frames = Frames(sequence, settings["speed"])
    settings_file = out / "orbslam3.yaml"
    settings_file.write_text(settings_text((sequence / "orbslam3.yaml").read_text(), settings))
    slam = pyorbslam3.Slam(vocabulary, settings_file, pyorbslam3.Sensor.MONOCULAR, use_viewer=False)
    tracked = run(slam, frames, out)
    time.sleep(_SETTLE_S)
    slam.shutdown()
    if tracked:
        save(slam, out, np.array(tracked))
    sys.stdout.flush()
    os._exit(0)  # its destructors may abort after all is written


def run(slam, frames: Frames, out: Path) -> list[float]:
    """Track every frame; the stamps of those that have a pose."""
    log, tracked = Log(out, "live.txt"), []
    for stamp_s, image in frames:
        with Clock() as clock:
            result = slam.track_monocular(image, stamp_s)
        log.frame(stamp_s, result.state.name, clock.ms, clock.cpu_ms)
        if result.ok and result.pose_valid:
            T_map_cam = np.asarray(result.pose_wc, float)
            log.pose(stamp_s, T_map_cam[:3, 3], quaternion_xyzw(T_map_cam[:3, :3]))
            tracked.append(stamp_s)
    log.close()
    return tracked


def save(slam, out: Path, tracked_s: np.ndarray) -> None:
    """Save the final poses in TUM's form, without frames that were lost, for which it keeps stale poses."""
    pid = os.fork()
    if pid == 0:  # saving a map without a keyframe ends the process
        slam.save_trajectory_euroc(str(out / "all.txt"))
        slam.save_keyframe_trajectory_euroc(str(out / "all_keyframes.txt"))
        os._exit(0)
    os.waitpid(pid, 0)
    for source, target in (("all.txt", "trajectory.txt"), ("all_keyframes.txt", "keyframes.txt")):
        lines = (out / source).read_text().splitlines() if (out / source).exists() else []
        rows = [line.replace(",", " ").split() for line in lines if line and not line.startswith("#")]
        kept = []
        for row in rows:
            stamp_s = float(row[0]) / 1e9
            nearest_s = tracked_s[np.abs(tracked_s - stamp_s).argmin()]
            if abs(nearest_s - stamp_s) < 1e-4:
                kept.append(" ".join([f"{nearest_s:.9f}", *row[1:8]]) + "\n")
        (out / target).write_text("".join(kept))


def settings_text(text: str, settings: dict) -> str:
    """The settings file of the sequence, with what is asked of this run."""
    if settings["features"]:
        text = re.sub(r"nFeatures: \d+", f"nFeatures: {int(settings['features'])}", text)
    return text if settings["loops"] else text + "loopClosing: 0\n"


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], json.loads(Path(sys.argv[4]).read_text()))
