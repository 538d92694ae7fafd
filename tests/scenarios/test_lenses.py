"""Lenses that cannot be inverted over their image are refused where the camera is read."""

import numpy as np
import pytest
from pydantic import ValidationError

from dslab.scenarios.errors import InputError
from dslab.scenarios.lenses import lens_fault
from dslab.scenarios.loading import load_scenario
from dslab.scenarios.spec import Camera
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.distortion import Lens
from dslab.slam.core.camera import PinholeCamera

FOLDS = {"model": "radtan", "k1": -2.0}


def test_a_scenario_s_lens_that_folds_the_image_is_not_valid(tmp_path):
    with pytest.raises(ValidationError, match="folds the image over itself"):
        Camera.model_validate({"distortion": FOLDS})
    text = "name: x\nworld: {kind: room}\ncamera:\n  distortion: {model: radtan, k1: -2}\n"
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(InputError, match=r"mine\.yaml:3: camera: distortion: .*give the coefficients"):
        load_scenario(tmp_path / "mine.yaml")


def test_a_lens_that_sees_behind_the_camera_is_not_valid():
    wide = {"fx_px": 130, "fy_px": 130, "distortion": {"model": "equidistant"}}
    with pytest.raises(ValidationError, match="sees more than 78 degrees to the side"):
        Camera.model_validate(wide)
    with pytest.raises(ValidationError, match="degrees to the side"):
        Camera.model_validate({**wide, "fx_px": 270, "fy_px": 270})


def test_a_lens_that_passes_the_check_can_be_rendered_and_estimated_with():
    rng = np.random.default_rng(0)
    passed = 0
    for _ in range(25):
        width, height, focal = 64, 48, 64 * rng.choice([0.5, 0.8, 1.5])
        model, count = [("radtan", 5), ("equidistant", 4)][rng.integers(2)]
        scale = 10 ** rng.uniform(-2, 0.5) * np.array([1, 1, 0.05, 0.05, 1][:count])
        coefficients = tuple((rng.normal(size=count) * scale).tolist())
        centre = (width / 2 - 0.5, height / 2 - 0.5)
        if lens_fault((width, height), (focal, focal), centre, model, coefficients) is None:
            camera = Intrinsics(width, height, focal, focal, *centre, 30.0, coefficients, model)
            assert Lens(camera).ideal.width_px > 0
            assert PinholeCamera(**camera.__dict__).distortion == coefficients
            passed += 1
    assert 5 < passed < 22
