"""A small sequence with everything in it, and helpers that corrupt its files."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError
from dslab.sim.io.forms import load_sequence
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import SegmentTruth, Sequence

COUNT, SHAPE = 6, (48, 64)
PINHOLE = Intrinsics(64, 48, 50.0, 51.1, 30.5, 20.25, 30.0)


class Stack(list):
    """Frames in memory."""


def make_sequence() -> Sequence:
    rng = np.random.default_rng(0)
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    poses[:, :3, :3] = Rotation.random(COUNT, rng).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(COUNT, 3))
    return Sequence(
        name="trial",
        camera=Intrinsics(64, 48, 50.0, 51.0, 30.5, 20.25, 30.0, (0.1, -0.2, 0.001, 0.002, 0.3)),
        stamps_s=np.arange(COUNT) / 30,
        frames=Stack(rng.integers(0, 256, (COUNT, *SHAPE), dtype=np.uint8)),
        T_world_cam=poses,
        depths=Stack(rng.uniform(0.5, 12, (COUNT, *SHAPE)).astype(np.float32)),
        segments=(SegmentTruth("motion_blur", {"exposure_s": 0.1}, 0.05, 0.1, 2, 3, "blur_px", 4.0),),
        meta={"seed": 3, "spec": {"name": "trial"}},
        frame_truth={"blur_px": np.array([0.0, 0, 9.5, 8, 0, 0]), "exposure_s": np.full(COUNT, 0.004)},
    )


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def fault(folder: Path, *expected: str) -> None:
    with pytest.raises(InputError) as caught:
        load_sequence(folder)
    line = str(caught.value)
    assert "\n" not in line
    for part in expected:
        assert part in line
