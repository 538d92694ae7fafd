"""Cameras of a spec: presets and their overriding, lens models, one line per fault."""

from pathlib import Path

import pytest
from pydantic import ValidationError

from dslab.scenarios.cameras import PRESETS, Camera, Distortion
from dslab.scenarios.errors import InputError
from dslab.scenarios.loading import dump_yaml, load_scenario
from dslab.scenarios.spec import Scenario


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_a_whole_camera(name):
    camera = Camera(preset=name)
    for field, value in PRESETS[name].items():
        expected = Distortion(**value) if field == "distortion" else value
        assert getattr(camera, field) == expected
    assert {"width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px", "fps"} <= set(PRESETS[name])


def test_a_preset_survives_writing_and_reading(tmp_path):
    spec = {"name": "trial", "world": {"kind": "room"}, "camera": {"preset": "euroc"}}
    scenario = Scenario.model_validate(spec)
    (tmp_path / "trial.yaml").write_text(dump_yaml(scenario))
    assert load_scenario(tmp_path / "trial.yaml") == scenario


def test_presets_have_the_published_numbers():
    kitti, euroc = Camera(preset="kitti"), Camera(preset="euroc")
    assert (kitti.width_px, kitti.height_px, kitti.fx_px, kitti.fps) == (1241, 376, 718.856, 10)
    assert kitti.distortion.coefficients == ()
    assert euroc.distortion.coefficients == (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0)


def test_fields_beside_a_preset_replace_its_own():
    camera = Camera(preset="euroc", fps=60, distortion={"model": "none"})
    assert camera.fps == 60 and camera.fx_px == 458.654 and camera.distortion == Distortion()


def test_the_defaults_without_a_preset():
    assert Camera().model_dump(exclude={"preset", "distortion"}, exclude_none=True) == {
        "width_px": 640,
        "height_px": 480,
        "fx_px": 500,
        "fy_px": 500,
        "cx_px": 319.5,
        "cy_px": 239.5,
        "fps": 30,
        "exposure_s": 0.004,
        "noise_sigma": 1.5,
        "shot_noise": 0,
        "softness_px": 0,
        "contrast": 1,
    }
    assert Camera().distortion.coefficients == ()


def test_coefficients_come_in_opencv_s_order():
    radtan = Distortion(model="radtan", k1=1, k2=2, k3=3, p1=4, p2=5)
    assert radtan.coefficients == (1, 2, 4, 5, 3)
    assert Distortion(model="equidistant", k1=1, k2=2, k3=3, k4=4).coefficients == (1, 2, 3, 4)


@pytest.mark.parametrize(
    ("distortion", "message"),
    [
        ({"model": "radtan", "k4": 0.1}, "the model radtan has no k4, use k1 k2 p1 p2 k3"),
        ({"model": "radtan", "k1": float("nan")}, "k1"),
    ],
)
def test_impossible_distortion_is_refused(distortion, message):
    with pytest.raises(ValidationError, match=message):
        Camera(distortion=distortion)


def fault(tmp_path: Path, camera: str) -> str:
    (tmp_path / "trial.yaml").write_text(f"name: trial\nworld: {{kind: room}}\ncamera: {camera}\n")
    with pytest.raises(InputError) as caught:
        load_scenario(tmp_path / "trial.yaml")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_faults_in_a_file_are_one_line(tmp_path):
    assert "camera.preset" in fault(tmp_path, "{preset: gopro}")
    assert "cx_px" in fault(tmp_path, "{preset: kitti, width_px: 320}")
    assert "camera.distortion" in fault(tmp_path, "{distortion: {k1: 0.1}}")
    assert "camera.distortion.k9" in fault(tmp_path, "{distortion: {k9: 0.1}}")


def test_a_calibration_error_needs_a_rectified_camera_and_a_lens_that_can_be_inverted():
    with pytest.raises(ValidationError, match="rectified"):
        Camera(preset="euroc", residual={"k1": 0.01})
    with pytest.raises(ValidationError, match="less than or equal"):
        Camera(residual={"k1": 3})
    with pytest.raises(ValidationError, match="residual: the lens"):
        Camera(fx_px=100, fy_px=100, residual={"k1": -0.2})
