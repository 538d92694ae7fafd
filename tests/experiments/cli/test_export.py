"""``dslab export`` and `degrade`: the same sequence in every form, one line per fault."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from dslab.experiments.cli.commands import app
from dslab.experiments.runs.sources import open_sequence
from dslab.scenarios.errors import InputError
from dslab.sim.io.euroc import load_euroc_imu
from dslab.sim.sensors.imu import GRAVITY_MPS2

SPEC = """
name: trial
seed: 5
duration_s: 1
world: {kind: corridor, length_m: 10, turns: 0}
camera: {width_px: 96, height_px: 64, fx_px: 70, fy_px: 70, cx_px: 47.5, cy_px: 31.5, fps: 20, %s}
segments: [{kind: motion_blur, start_s: 0.4, duration_s: 0.3, exposure_s: 0.04}]
"""
# The same seed everywhere: only the last world is cached.
SEED = ("--seed", "3")
FISHEYE = "distortion: {model: equidistant, k1: -0.01, k2: 0.02}"


@pytest.fixture(autouse=True)
def shared_cache(tmp_path_factory, monkeypatch):
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
    export(scenario, *SEED, "--format", form, "--out", str(tmp_path / "out"))
    rendered, read = open_sequence(scenario, 3), open_sequence(str(tmp_path / "out"))
    assert read.camera == rendered.camera and len(read) == 20
    for index in range(20):
        np.testing.assert_array_equal(read.frames[index], rendered.frames[index])
    np.testing.assert_allclose(read.stamps_s, rendered.stamps_s, atol=5.1e-10, rtol=0)
    np.testing.assert_allclose(read.T_world_cam, rendered.T_world_cam, atol=1e-8)
    assert read.segments == rendered.segments and read.meta["seed"] == 3


def test_a_distorted_camera_passes_through_the_files(tmp_path):
    (tmp_path / "fisheye.yaml").write_text(SPEC % FISHEYE)
    export(str(tmp_path / "fisheye.yaml"), *SEED, "--format", "euroc", "--out", str(tmp_path / "euroc"))
    export(str(tmp_path / "euroc"), "--format", "tum", "--out", str(tmp_path / "tum"))
    first, last = open_sequence(str(tmp_path / "fisheye.yaml"), 3), open_sequence(str(tmp_path / "tum"))
    assert last.camera == first.camera and first.camera.model == "equidistant"
    np.testing.assert_array_equal(last.frames[7], first.frames[7])


def dslab(*arguments: str) -> str:
    result = CliRunner().invoke(app, list(arguments))
    if result.exception:
        raise result.exception
    # Long lines are wrapped.
    return " ".join(result.output.split())


def test_synthetic_inertial_readings_are_repeatable(scenario, tmp_path):
    export(scenario, *SEED, "--format", "euroc", "--imu", "--out", str(tmp_path / "out"))
    readings = load_euroc_imu(tmp_path / "out")
    sequence = open_sequence(str(tmp_path / "out"))
    assert readings.stamps_s[0] == 0 and readings.stamps_s[-1] == pytest.approx(sequence.stamps_s[-1])
    R = sequence.T_world_cam[::10, :3, :3] @ readings.model.T_cam_imu[:3, :3]
    force = np.einsum("nij,nj->ni", R, readings.accel_mps2[::100])
    assert np.abs(force - [0, 0, 9.81]).max() < 3
    export(scenario, *SEED, "--format", "euroc", "--imu", "--out", str(tmp_path / "again"))
    again = load_euroc_imu(tmp_path / "again")
    np.testing.assert_array_equal(again.gyro_radps, readings.gyro_radps)
    np.testing.assert_array_equal(again.accel_mps2, readings.accel_mps2)


def test_inertial_readings_in_a_folder_integrate_to_the_true_motion(tmp_path):
    spec = SPEC % "noise_sigma: 1" + "imu: {preset: perfect, rate_hz: 400}\n"
    spec = spec.replace("}]", "}, {kind: fast_rotation, start_s: 0.2, duration_s: 0.6, rate_degps: 90}]")
    (tmp_path / "flight.yaml").write_text(spec)
    out = tmp_path / "out"
    text = dslab("export", str(tmp_path / "flight.yaml"), *SEED, "--format", "euroc", "--out", str(out))
    assert "imu0" in text
    sequence, readings = open_sequence(str(out)), load_euroc_imu(out)
    assert readings.model.rate_hz == 400 and readings.model.accel_walk == 0
    truth = np.loadtxt(out / "mav0/state_groundtruth_estimate0/data.csv", delimiter=",")
    T_world_imu = sequence.T_world_cam @ readings.model.T_cam_imu
    dt = 1 / 400
    R, p, v = T_world_imu[0, :3, :3], T_world_imu[0, :3, 3].copy(), truth[0, 8:11].copy()
    path = [p.copy()]
    for k in range(len(readings.stamps_s) - 1):
        turn = Rotation.from_rotvec((readings.gyro_radps[k] + readings.gyro_radps[k + 1]) / 2 * dt)
        R_next = R @ turn.as_matrix()
        a = (R @ readings.accel_mps2[k] + R_next @ readings.accel_mps2[k + 1]) / 2 + GRAVITY_MPS2
        p, v, R = p + v * dt + a * dt * dt / 2, v + a * dt, R_next
        path.append(p.copy())
    assert np.linalg.norm(T_world_imu[-1, :3, 3] - T_world_imu[0, :3, 3]) > 0.3
    errors_m = np.linalg.norm(np.array(path)[::20] - T_world_imu[:, :3, 3], axis=1)
    assert len(errors_m) == 20 and errors_m.max() < 0.001
    relative = Rotation.from_matrix(R.T @ T_world_imu[-1, :3, :3])
    assert np.rad2deg(relative.magnitude()) < 0.01


def test_an_imu_changes_no_frame_and_other_forms_leave_it_out(scenario, tmp_path):
    spec = (tmp_path / "trial.yaml").read_text()
    (tmp_path / "imu.yaml").write_text(spec + "imu: {preset: realsense}\n")
    text = dslab("export", str(tmp_path / "imu.yaml"), *SEED, "--out", str(tmp_path / "tum"))
    assert "inertial readings are left out, use --format euroc" in text
    with_imu, without = open_sequence(str(tmp_path / "tum")), open_sequence(scenario, 3)
    for index in range(20):
        np.testing.assert_array_equal(with_imu.frames[index], without.frames[index])


def test_depth_is_written_on_request_and_kept_where_present(scenario, tmp_path):
    tum, again, euroc = (str(tmp_path / name) for name in ("tum", "again", "euroc"))
    export(scenario, *SEED, "--format", "tum", "--depth", "--out", tum)
    export(tum, "--format", "tum", "--out", again)
    first, second = open_sequence(tum), open_sequence(again)
    for index in (0, 11, 19):
        assert first.depths[index].max() > 0.5
        np.testing.assert_array_equal(second.depths[index], first.depths[index])
    assert "depth images are left out" in dslab("export", tum, "--format", "euroc", "--out", euroc)
    with pytest.raises(InputError, match="kitti has no depth images; use --format tum"):
        export(scenario, *SEED, "--format", "kitti", "--depth", "--out", str(tmp_path / "no"))
    with pytest.raises(InputError, match="no depth images"):
        export(euroc, "--format", "tum", "--depth", "--out", str(tmp_path / "no"))
    assert not (tmp_path / "no").exists()


SEGMENTS = (
    "moving_objects:start_s=0.2,duration_s=0.5,share=0.3",
    "rain:start_s=0.2,duration_s=0.6,rate_mmph=50",
)


@pytest.mark.parametrize("form", ["tum", "kitti", "euroc"])
def test_a_degraded_folder_keeps_its_form_and_contents(tmp_path, form):
    (tmp_path / "trial.yaml").write_text(SPEC % "noise_sigma: 1" + "imu: {preset: euroc}\n")
    source, out = str(tmp_path / "source"), str(tmp_path / "out")
    more = ["--depth"] if form == "tum" else []
    dslab("export", str(tmp_path / "trial.yaml"), *SEED, "--format", form, *more, "--out", source)
    options = [word for text in SEGMENTS for word in ("--segment", text)]
    text = dslab("degrade", source, *options, "--out", out)
    assert f"20 frames in {form} form" in text
    before, after = open_sequence(source), open_sequence(out)
    assert after.camera == before.camera
    np.testing.assert_array_equal(after.stamps_s, before.stamps_s)
    np.testing.assert_allclose(after.T_world_cam, before.T_world_cam, atol=1e-8)
    kinds = [segment.kind for segment in after.segments]
    assert kinds == ["motion_blur", "moving_objects", "rain"]
    masks = {segment.kind: segment.mask(20) for segment in after.segments}
    np.testing.assert_array_equal(np.flatnonzero(masks["rain"]), np.arange(4, 16))
    changed = [not np.array_equal(a, b) for a, b in zip(after.frames, before.frames, strict=True)]
    np.testing.assert_array_equal(changed, masks["rain"] | masks["moving_objects"])
    assert {"rain_veil", "foreign_share", "blur_px"} <= set(after.frame_truth)
    if form == "tum":
        np.testing.assert_array_equal(after.depths[7], before.depths[7])
    if form == "euroc":
        first, second = load_euroc_imu(tmp_path / "source"), load_euroc_imu(tmp_path / "out")
        np.testing.assert_array_equal(second.stamps_s, first.stamps_s)
        np.testing.assert_array_equal(second.gyro_radps, first.gyro_radps)
        np.testing.assert_array_equal(second.accel_mps2, first.accel_mps2)
        np.testing.assert_allclose(second.model.T_cam_imu, first.model.T_cam_imu, atol=1e-12)


def test_bad_input_leaves_nothing_behind(scenario, tmp_path):
    out = str(tmp_path / "out")
    with pytest.raises(InputError, match="kitti has no inertial readings; use --format euroc"):
        export(scenario, *SEED, "--format", "kitti", "--imu", "--out", out)
    (tmp_path / "fisheye.yaml").write_text(SPEC % FISHEYE)
    with pytest.raises(InputError, match="rectified"):
        export(str(tmp_path / "fisheye.yaml"), *SEED, "--format", "kitti", "--out", out)
    assert not (tmp_path / "out").exists()
    export(scenario, *SEED, "--format", "tum", "--out", out)
    with pytest.raises(InputError, match="no continuous motion"):
        export(out, "--format", "euroc", "--imu", "--out", str(tmp_path / "more"))
    with pytest.raises(InputError, match="already holds files"):
        export(scenario, *SEED, "--format", "tum", "--out", out)
