from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dslab.slam.core.camera import NO_RESIDUAL, PinholeCamera, distort_residual

CAMERA = PinholeCamera(640, 480, 500.0, 510.0, 318.0, 242.0, 30.0)
LENSES = {
    "tum_fr1": (0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "barrel": (-0.28, 0.07, 0.0005, -0.0003, 0.0),
    "pincushion": (0.15, 0.0, 0.0, 0.0, 0.0),
}


def distort(camera, ideal):
    """NumPy reference: the radtan polynomial, on pixels."""
    k1, k2, p1, p2, k3 = camera.distortion
    x, y = (ideal[:, 0] - camera.cx) / camera.fx, (ideal[:, 1] - camera.cy) / camera.fy
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([xd * camera.fx + camera.cx, yd * camera.fy + camera.cy], axis=1)


@pytest.mark.parametrize("lens", LENSES)
def test_undistort_inverts_the_lens_over_the_whole_image(lens):
    camera = replace(CAMERA, distortion=LENSES[lens])
    grid = np.stack(np.meshgrid(np.linspace(0, 639, 40), np.linspace(0, 479, 30)), axis=-1)
    xy = grid.reshape(-1, 2).astype(np.float32)
    ideal = camera.undistort_points(xy)
    assert ideal.dtype == np.float32 and ideal.shape == xy.shape
    assert np.abs(ideal - xy).max() > 2
    assert np.abs(distort(camera, ideal.astype(float)) - xy).max() < 0.01


def test_undistort_without_distortion_is_the_same_array():
    xy = np.ones((7, 2), np.float32)
    assert CAMERA.undistort_points(xy) is xy


@pytest.mark.parametrize("distortion", [CAMERA.distortion, LENSES["barrel"]])
def test_undistort_accepts_an_empty_array(distortion):
    camera = replace(CAMERA, distortion=distortion)
    assert camera.undistort_points(np.empty((0, 2), np.float32)).shape == (0, 2)


def test_bounds_without_distortion_are_the_edges_of_the_image():
    assert CAMERA.undistorted_bounds() == (-0.5, -0.5, 639.5, 479.5)


@pytest.mark.parametrize("lens", LENSES)
def test_bounds_enclose_every_undistorted_pixel_tightly(lens):
    camera = replace(CAMERA, distortion=LENSES[lens])
    x_min, y_min, x_max, y_max = camera.undistorted_bounds()
    grid = np.stack(np.meshgrid(np.arange(640), np.arange(480)), axis=-1).reshape(-1, 2).astype(np.float32)
    ideal = camera.undistort_points(grid)
    low, high = ideal.min(axis=0), ideal.max(axis=0)
    assert (low >= (x_min, y_min)).all() and (high <= (x_max, y_max)).all()
    assert (low - (x_min, y_min) < 2).all() and ((x_max, y_max) - high < 2).all()


def test_camera_matrix_projects():
    assert np.allclose(CAMERA.K @ (0.2, -0.1, 1), (0.2 * 500 + 318, -0.1 * 510 + 242, 1))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("width_px", 0),
        ("width_px", 640.5),
        ("height_px", -480),
        ("fx", 0.0),
        ("fx", float("nan")),
        ("fy", float("inf")),
        ("fy", -500.0),
        ("cx", -1.0),
        ("cx", 641.0),
        ("cy", float("nan")),
        ("cy", 900.0),
        ("fps", 0.0),
        ("fps", float("inf")),
        ("distortion", (0.1, 0.0, 0.0, 0.0)),
        ("distortion", (float("nan"), 0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_bad_intrinsics_are_refused_by_name(field, value):
    with pytest.raises(ValueError, match=f"camera {field} "):
        replace(CAMERA, **{field: value})


def test_distortion_that_folds_the_image_is_refused():
    with pytest.raises(ValueError, match="cannot be taken out"):
        replace(CAMERA, distortion=(-2.0, 0.0, 0.0, 0.0, 0.0))


def test_undistorted_point_agrees_with_the_undistorted_image():
    camera = replace(CAMERA, distortion=LENSES["barrel"])
    image = np.zeros((480, 640), np.float32)
    cv2.circle(image, (560, 90), 4, 1.0, -1)
    moments = cv2.moments(cv2.undistort(image, camera.K, np.array(camera.distortion)))
    centre = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
    assert np.abs(camera.undistort_points(np.array([[560, 90]], np.float32))[0] - centre).max() < 0.1


FISHEYE = replace(CAMERA, fx=300.0, fy=302.0, distortion=(-0.01, 0.02, -0.012, 0.002), model="equidistant")


def distort_equidistant(camera, ideal):
    """NumPy reference: the angle's polynomial, on pixels."""
    x, y = (ideal[:, 0] - camera.cx) / camera.fx, (ideal[:, 1] - camera.cy) / camera.fy
    radius = np.hypot(x, y)
    theta = np.arctan(radius)
    bent = theta * (1 + sum(k * theta ** (2 * i) for i, k in enumerate(camera.distortion, start=1)))
    return np.stack([x * bent / radius * camera.fx + camera.cx, y * bent / radius * camera.fy + camera.cy], 1)


@pytest.mark.parametrize("distortion", [FISHEYE.distortion, (0.0, 0.0, 0.0, 0.0)])
def test_undistort_inverts_a_fisheye_over_the_whole_image(distortion):
    camera = replace(FISHEYE, distortion=distortion)
    grid = np.stack(np.meshgrid(np.linspace(0, 639, 40), np.linspace(0, 479, 30)), axis=-1)
    xy = grid.reshape(-1, 2).astype(np.float32)
    ideal = camera.undistort_points(xy)
    assert ideal.dtype == np.float32 and ideal.shape == xy.shape
    assert np.abs(ideal - xy).max() > 100
    assert np.abs(distort_equidistant(camera, ideal.astype(float)) - xy).max() < 0.01
    x_min, y_min, x_max, y_max = camera.undistorted_bounds()
    assert (ideal >= (x_min, y_min)).all() and (ideal <= (x_max, y_max)).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": "omni"}, "camera model must be radtan or rational or equidistant"),
        ({"distortion": (0.0,) * 5}, "camera distortion must be 4 finite numbers"),
        ({"distortion": (-3.0, 0.0, 0.0, 0.0)}, "cannot be taken out"),
        ({"fx": 120.0, "fy": 120.0}, "cannot be taken out"),
    ],
)
def test_bad_fisheyes_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(FISHEYE, **change)


def test_a_residual_distortion_is_that_of_opencv_and_inverted_to_a_hundredth_of_a_pixel():
    xy = np.random.default_rng(0).uniform([0, 0], [1242, 375], (500, 2)).astype(np.float32)
    camera = PinholeCamera(
        1242, 375, 721.5, 721.5, 609.6, 172.9, 10.0, residual=(0.02, -0.006, 0.001, -0.002)
    )
    ideal = camera.undistort_points(xy)
    assert np.abs(ideal - xy).max() > 3
    own = replace(camera, residual=NO_RESIDUAL, distortion=(*camera.residual, 0.0))
    assert distort(own, ideal) == pytest.approx(camera.distort_points(ideal), abs=1e-3)
    assert np.abs(distort_residual(ideal, camera.residual, camera.intrinsics) - xy).max() < 0.01


def test_rows_read_one_after_the_other_are_taken_to_the_middle_one():
    """Points before a camera that moves and turns: each is seen where it is when its row is read."""
    camera = replace(CAMERA, readout_s=0.02)
    rng = np.random.default_rng(0)
    twist, depth = np.array([0.2, -0.3, 0.4, 0.5, -0.6, 0.7]), 3.0
    points = np.column_stack([rng.uniform(-1.5, 1.5, 200), rng.uniform(-1.2, 1.2, 200), np.full(200, depth)])

    def pixels(t_s):
        turn = Rotation.from_rotvec(t_s[:, None] * twist[3:])
        moved = turn.apply(points) + t_s[:, None] * twist[:3] * depth
        return moved[:, :2] / moved[:, 2:] * camera.intrinsics[:2] + camera.intrinsics[2:]

    ideal = pixels(np.zeros(200))
    seen = ideal
    for _ in range(10):  # the row decides the time, and the time the row
        seen = pixels(camera.readout_s * ((seen[:, 1] + 0.5) / camera.height_px - 0.5))
    assert np.abs(seen - ideal).max() > 3.0
    assert camera.ideal_points(seen.astype(np.float32), twist) == pytest.approx(ideal, abs=0.1)
    assert camera.ideal_points(seen.astype(np.float32), np.zeros(6)) == pytest.approx(seen, abs=1e-3)
