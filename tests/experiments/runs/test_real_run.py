"""The SLAM itself through the whole of a run: breaks where the frames are blank, mends, and is judged."""

from dataclasses import asdict

import numpy as np
import pytest

from experiments.result_folder import run_sequence
from experiments.runs.execution import system_factory
from sim.sensors.camera import Intrinsics
from sim.sequence import SegmentTruth, Sequence
from slam.dual.config import DualConfig
from slam.dual.recovery.registry import ThreadSpec
from slam.warmup import CAMERA, toy_frames

RECOVERY_ALONE = DualConfig(threads=(ThreadSpec("orb"),), relocalization=False, place_merging=None)

BLANK = range(80, 86)


@pytest.fixture(scope="module")
def sequence():
    images, stamps_s, poses = zip(*toy_frames(200, BLANK), strict=True)
    stamps_s = np.array(stamps_s)
    segment = SegmentTruth("low_texture", {"contrast": 0.0}, stamps_s[80], stamps_s[86], 80, 85)
    return Sequence(
        name="toy",
        camera=Intrinsics(**asdict(CAMERA)),
        stamps_s=stamps_s,
        frames=images,
        T_world_cam=np.array(poses),
        depths=None,
        segments=(segment,),
        meta={},
    )


def test_base_breaks_in_the_blank_frames_and_finds_its_place_and_dual_mends_it(sequence, tmp_path):
    build = system_factory(dual=RECOVERY_ALONE)
    base, dual = (
        run_sequence(sequence, kind, 0, tmp_path / kind, recording=True, build=build)
        for kind in ("base", "dual")
    )
    assert base["breakage_list"][0]["segment"] == dual["breakage_list"][0]["segment"] == "low_texture"
    assert base["breakage_list"][0]["frame"] == dual["breakage_list"][0]["frame"]
    # What was before the camera is still in view after six frames: the base relocalizes.
    assert base["relocalizations"] == 1 and base["recoveries"] == 0
    assert base["audit"]["relocalizations"][0]["false"] is False
    assert dual["relocalizations"] == 0
    assert dual["recoveries"] == 1 and dual["maps"] == 1
    assert base["ate_share_of_path"] < 0.02 and dual["ate_share_of_path"] < 0.02
    (loss,) = base["audit"]["losses"]
    assert 0 <= loss["delay_s"] <= 0.5
    (fusion,) = dual["audit"]["fusions"]
    assert fusion["false"] is False
    assert (tmp_path / "dual" / "recording.rrd").stat().st_size > 1e5


def test_the_same_seed_gives_the_same_trajectory(sequence, tmp_path):
    for name in ("a", "b"):
        run_sequence(sequence, "dual", 5, tmp_path / name)
    assert (tmp_path / "a" / "trajectory.txt").read_bytes() == (
        tmp_path / "b" / "trajectory.txt"
    ).read_bytes()
