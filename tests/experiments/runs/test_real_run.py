"""The real SLAM systems through a whole run: breakage in blank frames, recovery, summary."""

import numpy as np
import pytest
from slam_fakes import run_sequence, simulated_camera

from dslab.experiments.runs.execution import system_factory
from dslab.sim.sequence import SegmentTruth, Sequence
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.recovery.registry import ThreadSpec
from dslab.slam.toy_sequence import CAMERA, toy_frames

RECOVERY_ALONE = DualConfig(recovery_threads=(ThreadSpec("orb"),), relocalization=False, place_merging=None)

BLANK = range(80, 86)


@pytest.fixture(scope="module")
def sequence():
    images, stamps_s, poses = zip(*toy_frames(200, BLANK), strict=True)
    stamps_s = np.array(stamps_s)
    segment = SegmentTruth("low_texture", {"contrast": 0.0}, stamps_s[80], stamps_s[86], 80, 85)
    return Sequence(
        name="toy",
        camera=simulated_camera(CAMERA),
        stamps_s=stamps_s,
        frames=images,
        T_world_cam=np.array(poses),
        depths=None,
        segments=(segment,),
        meta={},
    )


@pytest.fixture(scope="module")
def runs(sequence, tmp_path_factory):
    """Summaries of base and Dual-SLAM, the latter recorded, and the folder of their results."""
    folder, build = tmp_path_factory.mktemp("runs"), system_factory(dual=RECOVERY_ALONE)
    base, dual = (
        run_sequence(sequence, kind, 0, folder / kind, recording=kind == "dual", build=build)
        for kind in ("base", "dual")
    )
    return base, dual, folder


@pytest.mark.slow
def test_base_relocalizes_after_the_blank_frames_and_dual_slam_fuses_its_maps(runs):
    base, dual, folder = runs
    assert base["breakage_list"][0]["segment"] == dual["breakage_list"][0]["segment"] == "low_texture"
    assert base["breakage_list"][0]["frame"] == dual["breakage_list"][0]["frame"]
    # After six frames the old view is still in the image: the base relocalizes.
    assert base["relocalizations"] == 1 and base["recoveries"] == 0
    assert base["audit"]["relocalizations"][0]["false"] is False
    assert dual["relocalizations"] == 0
    assert dual["recoveries"] == 1 and dual["maps"] == 1
    assert base["ate_share_of_path"] < 0.02 and dual["ate_share_of_path"] < 0.02
    (loss,) = base["audit"]["losses"]
    assert 0 <= loss["delay_s"] <= 0.5
    (fusion,) = dual["audit"]["fusions"]
    assert fusion["false"] is False
    assert (folder / "dual" / "recording.rrd").stat().st_size > 1e5


@pytest.mark.slow
def test_the_same_seed_gives_the_same_trajectory_recorded_or_not(sequence, runs, tmp_path):
    run_sequence(sequence, "dual", 0, tmp_path / "again", build=system_factory(dual=RECOVERY_ALONE))
    one, other = (
        (folder / "trajectory.txt").read_bytes() for folder in (runs[2] / "dual", tmp_path / "again")
    )
    assert one == other
