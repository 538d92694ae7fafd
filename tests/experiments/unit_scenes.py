"""Units on synthetic images: boards passing by, blank in some frames."""

from functools import cache

import numpy as np

from dslab.experiments.eq1 import trial
from dslab.experiments.eq1.units import ThreadChoice, UnitSpec
from dslab.scenarios.spec import LowTexture, RoomWorld, Scenario
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import SegmentTruth, Sequence
from dslab.slam.toy_sequence import CAMERA, toy_frames

FRAMES, ONSET, END = 170, 75, 104
FPS = CAMERA.fps


@cache
def _images():
    images, stamps_s, T_world_cam = zip(*toy_frames(FRAMES, seed=0, step_m=0.05), strict=True)
    return np.array(images), np.array(stamps_s), np.array(T_world_cam)


def synthetic(*blank: range, frames: int = FRAMES) -> Sequence:
    """A sequence with the exposed segment ONSET to END, blank in some ranges of frames."""
    images, stamps_s, T_world_cam = (array[:frames] for array in _images())
    images = images.copy()
    for span in blank:
        images[span.start : span.stop] = 120
    segment = SegmentTruth("low_texture", {"contrast": 0.0}, ONSET / FPS, END / FPS, ONSET, END)
    camera = Intrinsics(CAMERA.width_px, CAMERA.height_px, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, FPS)
    return Sequence("made-up", camera, stamps_s, images, T_world_cam, None, (segment,), {})


def unit(threads: str = "orb,gms", **changes) -> UnitSpec:
    """A unit whose exposed segment is that of :func:`synthetic`."""
    segment = LowTexture(
        kind="low_texture", start_s=ONSET / FPS, duration_s=(END - ONSET + 1) / FPS, contrast=0.0
    )
    scenario = Scenario(name="made-up", world=RoomWorld(), duration_s=FRAMES / FPS, segments=(segment,))
    given = {
        "experiment": "test",
        "cell": "low_texture/1",
        "kind": "low_texture",
        "severity": 0.0,
        "index": 0,
        "world_seed": 1,
        "sequence_seed": 2,
        "repeat_seed": 3,
        "scenario": scenario,
        "onset_s": ONSET / FPS,
        "exposed_s": (END - ONSET + 1) / FPS,
        "threads": tuple(ThreadChoice(kind=kind) for kind in threads.split(",")),
    }
    return UnitSpec(**{**given, **changes})


def run(monkeypatch, sequence: Sequence, of: UnitSpec | None = None, **options) -> dict:
    """The record of a unit on given images."""
    monkeypatch.setattr(trial, "frames_of", lambda *_: sequence)
    monkeypatch.setattr(trial, "overlap_columns", lambda *_: {})  # the images are of no rendered world
    return trial.run_unit(of or unit(), **options)
