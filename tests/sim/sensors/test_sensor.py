"""The sensor of a scenario's camera, and frames with a calibration error."""

import numpy as np
import pytest
from small_world import CAMERA, CORRIDOR

from dslab.scenarios.cameras import Camera
from dslab.scenarios.spec import Scenario
from dslab.sim.link import View, fold
from dslab.sim.sensors import sensor
from dslab.sim.sensors.sensor import SensorNoise, sensor_links
from dslab.sim.sequence_rendering import render_sequence

SMALL = {**CAMERA, "noise_sigma": 0}


def sensed(image, frame=0, **fields):
    """The image behind all links of a sensor."""
    soft, developed = sensor_links(Camera.model_validate(SMALL | fields), 3)
    return fold([*soft, *developed], image, View(frame, 0.0))[0]


def test_a_camera_without_the_options_has_noise_alone():
    image = np.full((64, 96), 90, np.uint8)
    noisy = SensorNoise((64, 96), 2.0, 3).added(image, 5)
    np.testing.assert_array_equal(sensed(image, 5, noise_sigma=2.0), noisy)


def test_softness_spreads_a_point_by_its_standard_deviation():
    image = np.zeros((65, 65), np.uint8)
    image[32, 32] = 255
    soft = sensed(image, softness_px=1.5).astype(float)
    rows = np.arange(65) - 32
    assert np.sqrt((soft.sum(1) * rows**2).sum() / soft.sum()) == pytest.approx(1.5, rel=0.1)


def test_contrast_keeps_the_middle_and_clips_lights():
    ramp = np.arange(256, dtype=np.uint8).reshape(16, 16)
    out = sensed(ramp, contrast=1.5).ravel()
    assert (
        out[128] == 128
        and out[64] < 64
        and (out[210:] == 255).all()
        and (np.diff(out.astype(int)) >= 0).all()
    )


def test_shot_noise_grows_with_the_root_of_the_level():
    grays = (np.full((64, 96), level, np.uint8) for level in (40, 160))
    spread = [sensed(gray, 1, shot_noise=6.0).std() for gray in grays]
    assert spread[1] / spread[0] == pytest.approx(2, rel=0.1)
    assert spread[1] == pytest.approx(6 * np.sqrt(160 / 255), rel=0.1)


def rendered(tmp_path, name, **camera):
    spec = {"name": name, "duration_s": 0.4, "world": CORRIDOR, "camera": SMALL | camera}
    return render_sequence(Scenario.model_validate(spec), cache_dir=tmp_path)


def test_a_calibration_error_is_in_the_frames_and_not_in_the_camera(tmp_path):
    coefficients = {"k1": 0.12, "k2": -0.03}
    off = rendered(tmp_path, "off", residual=coefficients)
    known = rendered(tmp_path, "known", distortion={"model": "radtan", **coefficients})
    plain = rendered(tmp_path, "plain")
    assert off.camera.is_pinhole and off.camera == plain.camera and not known.camera.is_pinhole
    for frame in range(len(off)):
        np.testing.assert_array_equal(off.frames[frame], known.frames[frame])
        assert (off.frames[frame] != plain.frames[frame]).any()


def test_the_noise_of_a_seed_is_drawn_once_and_none_where_there_is_none(monkeypatch):
    asked, stream = [], sensor.rng_for
    monkeypatch.setattr(sensor, "rng_for", lambda *names: asked.append(names) or stream(*names))
    gray = np.full((64, 96), 128, np.uint8)
    for shot in (0.0, 2.0):
        first = SensorNoise((64, 96), 2.0, 41, shot).added(gray, 5)
        np.testing.assert_array_equal(SensorNoise((64, 96), 2.0, 41, shot).added(gray, 5), first)
        assert not np.array_equal(SensorNoise((64, 96), 2.0, 42, shot).added(gray, 5), first)
    SensorNoise((64, 96), 0.0, 43).added(gray, 5)
    assert [seed for seed, _, what in asked if what == "bank"] == [41, 42, 41, 42]
