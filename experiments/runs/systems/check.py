"""A short run of a system, to see whether what it gives can be used."""

import numpy as np

from dslab.experiments.runs.execution import RunRecord
from dslab.experiments.runs.systems.command import LOG_FILE
from dslab.experiments.runs.systems.registry import System
from dslab.experiments.runs.systems.run import run_system
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import Sequence
from dslab.sim.unfinished import scratch_folder
from dslab.slam.toy_sequence import CAMERA, toy_frames

_FRAMES = 60
_LOG_CHARACTERS = 2000


def made_up_sequence(frames: int = _FRAMES) -> Sequence:
    """A camera that moves past textured boards, 320 x 240 at 30 fps; it takes no rendering."""
    images, stamps_s, poses = zip(*toy_frames(frames, step_m=0.05), strict=True)
    size, focal = (CAMERA.width_px, CAMERA.height_px), (CAMERA.fx, CAMERA.fy)
    camera = Intrinsics(*size, *focal, CAMERA.cx, CAMERA.cy, CAMERA.fps)
    return Sequence("made-up", camera, np.array(stamps_s), images, np.array(poses), None, (), {})


def run_once(system: System, sequence: Sequence) -> tuple[RunRecord, str]:
    """Run a system; the record, and the end of what a program has printed.

    Raises:
        InputError: it cannot be started or made.
    """
    with scratch_folder() as scratch:
        record = run_system(system, sequence, 0, folder=scratch)
        log = scratch / LOG_FILE
        return record, log.read_text(errors="replace")[-_LOG_CHARACTERS:] if log.exists() else ""
