"""``dslab export``: the same sequence in every form, and one line for every fault."""

import numpy as np
import pytest
from typer.testing import CliRunner

from experiments.cli import app
from experiments.sources import open_sequence
from scenarios.errors import InputError
from sim.io.euroc_reader import load_euroc_imu

SPEC = """
name: trial
duration_s: 1
world: {kind: room}
camera: {width_px: 96, height_px: 64, fx_px: 70, fy_px: 70, cx_px: 47.5, cy_px: 31.5, fps: 20, %s}
segments: [{kind: motion_blur, start_s: 0.4, duration_s: 0.3, exposure_s: 0.04}]
"""
FISHEYE = "distortion: {model: equidistant, k1: -0.01, k2: 0.02}"


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("DSLAB_CACHE_DIR", str(tmp_path_factory.getbasetemp() / "export-cache"))


@pytest.fixture
def scenario(tmp_path) -> str:
    (tmp_path / "trial.yaml").write_text(SPEC % "noise_sigma: 1")
    return str(tmp_path / "trial.yaml")


def export(*arguments: str) -> None:
    result = CliRunner().invoke(app, ["export", *arguments])
    if result.exception:
        raise result.exception


@pytest.mark.parametrize("form", ["tum", "kitti", "euroc"])
def test_an_exported_scenario_is_the_scenario(scenario, tmp_path, form):
    export(scenario, "--seed", "3", "--format", form, "--out", str(tmp_path / "out"))
    rendered, read = open_sequence(scenario, 3), open_sequence(str(tmp_path / "out"))
    assert read.camera == rendered.camera and len(read) == 20
    for index in range(20):
        np.testing.assert_array_equal(read.frames[index], rendered.frames[index])
    np.testing.assert_allclose(read.stamps_s, rendered.stamps_s, atol=5.1e-10, rtol=0)
    np.testing.assert_allclose(read.T_world_cam, rendered.T_world_cam, atol=1e-8)
    assert read.segments == rendered.segments and read.meta["seed"] == 3


def test_a_distorted_camera_passes_from_the_scenario_through_the_files(tmp_path):
    (tmp_path / "fisheye.yaml").write_text(SPEC % FISHEYE)
    export(str(tmp_path / "fisheye.yaml"), "--format", "euroc", "--out", str(tmp_path / "euroc"))
    export(str(tmp_path / "euroc"), "--format", "tum", "--out", str(tmp_path / "tum"))
    first, last = open_sequence(str(tmp_path / "fisheye.yaml")), open_sequence(str(tmp_path / "tum"))
    assert last.camera == first.camera and first.camera.model == "equidistant"
    np.testing.assert_array_equal(last.frames[7], first.frames[7])


def test_inertial_readings_follow_the_scenario_s_motion(scenario, tmp_path):
    export(scenario, "--format", "euroc", "--imu", "--out", str(tmp_path / "out"))
    readings = load_euroc_imu(tmp_path / "out")
    sequence = open_sequence(str(tmp_path / "out"))
    assert readings.stamps_s[0] == 0 and readings.stamps_s[-1] == pytest.approx(sequence.stamps_s[-1])
    R = sequence.T_world_cam[::10, :3, :3] @ readings.model.T_cam_imu[:3, :3]
    force = np.einsum("nij,nj->ni", R, readings.accel_mps2[::100])
    assert np.abs(force - [0, 0, 9.81]).max() < 3
    export(scenario, "--format", "euroc", "--imu", "--out", str(tmp_path / "again"))
    again = load_euroc_imu(tmp_path / "again")
    np.testing.assert_array_equal(again.gyro_radps, readings.gyro_radps)
    np.testing.assert_array_equal(again.accel_mps2, readings.accel_mps2)


def test_faults_are_one_line_and_leave_nothing(scenario, tmp_path):
    out = str(tmp_path / "out")
    with pytest.raises(InputError, match="kitti has no inertial readings; use --format euroc"):
        export(scenario, "--format", "kitti", "--imu", "--out", out)
    (tmp_path / "fisheye.yaml").write_text(SPEC % FISHEYE)
    with pytest.raises(InputError, match="rectified"):
        export(str(tmp_path / "fisheye.yaml"), "--format", "kitti", "--out", out)
    assert not (tmp_path / "out").exists()
    export(scenario, "--format", "tum", "--out", out)
    with pytest.raises(InputError, match="no continuous motion"):
        export(out, "--format", "euroc", "--imu", "--out", str(tmp_path / "more"))
    with pytest.raises(InputError, match="not empty"):
        export(scenario, "--format", "tum", "--out", out)
