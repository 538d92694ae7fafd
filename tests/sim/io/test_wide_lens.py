"""Images of a fisheye lens that a pinhole cannot hold are rectified, and it is said."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from dslab.scenarios.errors import InputError, InputNotice
from dslab.sim.io.camera_file import write_camera
from dslab.sim.io.forms import load_sequence
from dslab.sim.io.wide_lens import rectified
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.distortion import unproject
from dslab.slam.core.camera import PinholeCamera

# TUM-VI's left camera, by its published calibration rounded.
WIDE = Intrinsics(
    512, 512, 190.98, 190.97, 254.93, 256.9, 20.0, (0.0034, 0.0007, -0.002, 0.0002), "equidistant"
)


def seen(rays):
    """A smooth picture of directions."""
    theta, phi = np.arctan(np.hypot(*np.moveaxis(rays, -1, 0))), np.arctan2(rays[..., 1], rays[..., 0])
    return 128 + 60 * np.cos(9 * theta) + 40 * np.sin(3 * phi) * np.sin(theta)


def rays_of(camera):
    """By inverting the polynomial on a fine grid; only to where the lens sees."""
    x, y = np.meshgrid(*camera.rays())
    theta = np.linspace(0, 1.9, 20000)
    radius = theta * (1 + sum(k * theta ** (2 * n + 2) for n, k in enumerate(camera.distortion)))
    angle = np.interp(np.hypot(x, y), radius, theta)
    stretch = np.tan(np.minimum(angle, 1.5)) / np.maximum(np.hypot(x, y), 1e-9)
    return np.stack([x * stretch, y * stretch], axis=-1)


def test_the_middle_of_the_view_is_that_of_a_pinhole(tmp_path):
    (tmp_path / "walk").mkdir()
    cv2.imwrite(str(tmp_path / "walk" / "1.png"), np.rint(seen(rays_of(WIDE))).astype(np.uint8))
    write_camera(WIDE, tmp_path / "camera.yaml")
    with pytest.warns(InputNotice, match=r"walk: the lens sees more than 78 degrees.*106 x 106 degrees"):
        sequence = load_sequence(tmp_path / "walk", tmp_path / "camera.yaml")
    assert sequence.camera == replace(WIDE, model="radtan", distortion=(0.0,) * 5)
    expected = seen(np.stack(np.meshgrid(*sequence.camera.rays()), -1))
    assert np.abs(sequence.frames[0] - expected)[8:-8, 8:-8].max() < 2
    PinholeCamera(512, 512, *sequence.camera.focal_px, *sequence.camera.centre_px, 20.0)


def test_a_narrow_lens_is_left_to_the_system_and_a_folded_one_refused(tmp_path, recwarn):
    (tmp_path / "walk").mkdir()
    cv2.imwrite(str(tmp_path / "walk" / "1.png"), np.full((512, 512), 90, np.uint8))
    narrow = replace(WIDE, fx=290.0, fy=290.0)
    write_camera(narrow, tmp_path / "camera.yaml")
    assert load_sequence(tmp_path / "walk", tmp_path / "camera.yaml").camera == narrow and not recwarn.list
    write_camera(replace(WIDE, distortion=(-0.4, 0.0, 0.0, 0.0)), tmp_path / "camera.yaml")
    with pytest.raises(InputError, match=r"distortion: the lens .* folds"):
        load_sequence(tmp_path / "walk", tmp_path / "camera.yaml")


def test_a_notice_is_one_line_on_the_terminal(dslab, tmp_path, monkeypatch):
    (tmp_path / "walk").mkdir()
    for n in range(3):
        cv2.imwrite(str(tmp_path / "walk" / f"{n}.png"), np.full((512, 512), 90, np.uint8))
    write_camera(WIDE, tmp_path / "camera.yaml")
    made, camera = tmp_path / "o", tmp_path / "camera.yaml"
    code, _, err = dslab("export", tmp_path / "walk", "--camera", camera, "--format", "tum", "--out", made)
    notes = [line for line in err.splitlines() if line.startswith("note: ")]
    assert (code, len(notes)) == (0, 1), err


@pytest.mark.parametrize("k1", [-0.25, 0.25])
def test_a_rectified_sequence_is_what_a_pinhole_sees_without_black_pixels(tmp_path, k1):
    camera = Intrinsics(320, 240, 250.0, 240.0, 150.0, 125.0, 30.0, (k1, 0.05, 0.001, -0.001, 0.0))
    grid = np.stack(np.meshgrid(np.arange(320.0), np.arange(240.0)), -1)
    rays = unproject(camera, grid.reshape(-1, 2)).reshape(240, 320, 2)
    (tmp_path / "walk").mkdir()
    cv2.imwrite(str(tmp_path / "walk" / "1.png"), np.rint(seen(rays)).astype(np.uint8))
    write_camera(camera, tmp_path / "camera.yaml")
    sequence = rectified(load_sequence(tmp_path / "walk", tmp_path / "camera.yaml"))
    ideal = sequence.camera
    assert ideal.is_pinhole and (ideal.size_px, ideal.centre_px) == (camera.size_px, camera.centre_px)
    assert ideal.fx == camera.fx if k1 < 0 else 1 < ideal.fx / camera.fx < 1.3
    expected = seen(np.stack(np.meshgrid(*ideal.rays()), -1))
    assert np.abs(sequence.frames[0] - expected)[1:-1, 1:-1].max() < 4
    assert rectified(sequence) is sequence


def test_a_distorted_sequence_is_exported_to_kitti_if_rectified(dslab, tmp_path):
    (tmp_path / "walk").mkdir()
    for n in range(3):
        cv2.imwrite(str(tmp_path / "walk" / f"{n}.png"), np.full((240, 320), 90, np.uint8))
    write_camera(
        Intrinsics(320, 240, 250.0, 240.0, 150.0, 125.0, 30.0, (0.1, 0, 0, 0, 0)), tmp_path / "cam.yaml"
    )
    words = ["export", tmp_path / "walk", "--camera", tmp_path / "cam.yaml", "--format", "kitti", "--out"]
    code, _, err = dslab(*words, tmp_path / "out")
    assert code == 2 and "--rectify" in err
    assert dslab(*words, tmp_path / "out", "--rectify")[0] == 0
    assert load_sequence(tmp_path / "out").frames[1].min() == 90
