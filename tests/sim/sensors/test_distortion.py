"""Lens distortion: dots where OpenCV projects them, exact depth of planes, no mixture at outlines."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from dslab.scenarios.errors import InputError
from dslab.scenarios.lenses import straightened
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.distortion import (
    Lens,
    project,
    sample_depth,
    unproject,
)

EUROC = Intrinsics(
    752, 480, 458.654, 457.296, 367.215, 248.375, 20.0, (-0.28340811, 0.07395907, 0.00019359, 1.76e-05, 0.0)
)
LENSES = {
    "euroc": EUROC,
    "five": Intrinsics(640, 480, 520.0, 510.0, 330.0, 235.0, 30.0, (-0.2, 0.06, 0.001, -0.002, 0.01)),
    "pincushion": Intrinsics(640, 480, 500.0, 500.0, 319.5, 239.5, 30.0, (0.15, 0.0, 0.0, 0.0, 0.0)),
    "fisheye": Intrinsics(
        640, 480, 400.0, 402.0, 322.0, 238.0, 30.0, (-0.01, 0.02, -0.012, 0.002), "equidistant"
    ),
    "ideal fisheye": Intrinsics(
        640, 480, 400.0, 400.0, 319.5, 239.5, 30.0, (0.0, 0.0, 0.0, 0.0), "equidistant"
    ),
}
SIGMA_PX = 1.5


def opencv_pixels(camera: Intrinsics, rays: np.ndarray) -> np.ndarray:
    points = np.column_stack([rays, np.ones(len(rays))])[:, None]
    of_model = cv2.fisheye.projectPoints if camera.model == "equidistant" else cv2.projectPoints
    return of_model(points, np.zeros(3), np.zeros(3), camera.K, np.array(camera.distortion))[0][:, 0]


class Dots:
    """Renders soft dots on black as a pinhole camera sees them, on a plane at 2 m.

    Args:
        camera: the pinhole camera.
        rays: (N, 2) of the dots.
        spread_px: (N,) size of each dot in this image, standard deviation.
    """

    def __init__(self, camera: Intrinsics, rays: np.ndarray, spread_px: np.ndarray) -> None:
        self.camera, self._rays, self._spread_px = camera, rays, spread_px

    def render(self):
        c = self.camera
        image = np.zeros((c.height_px, c.width_px))
        u, v = np.arange(c.width_px), np.arange(c.height_px)
        at = self._rays * (c.fx, c.fy) + (c.cx, c.cy)
        for (x, y), spread in zip(at, self._spread_px, strict=True):
            image += np.outer(np.exp(-(((v - y) / spread) ** 2) / 2), np.exp(-(((u - x) / spread) ** 2) / 2))
        return np.rint(250 * np.clip(image, 0, 1)).astype(np.uint8)


def dot_pixels(camera: Intrinsics) -> np.ndarray:
    x = np.linspace(25, camera.width_px - 26, 9) + 0.3
    y = np.linspace(25, camera.height_px - 26, 7) + 0.7
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def wide_pixels_per_pixel(camera: Intrinsics, xy: np.ndarray) -> np.ndarray:
    """(N,) width of a pixel in pixels of the ideal camera, the mean over directions."""
    ends = [unproject(camera, xy + step) for step in ((0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5))]
    along_x, along_y = ((ends[i] - ends[i + 1]) * (camera.fx, camera.fy) for i in (0, 2))
    return np.sqrt(np.abs(along_x[:, 0] * along_y[:, 1] - along_x[:, 1] * along_y[:, 0]))


@pytest.mark.parametrize("name", ["euroc", "fisheye"])
def test_dots_lie_where_opencv_projects_them(name):
    camera = LENSES[name]
    rays = unproject(camera, dot_pixels(camera))
    spread_px = SIGMA_PX * wide_pixels_per_pixel(camera, dot_pixels(camera))
    lens = Lens(camera)
    gray = lens.distort(Dots(lens.ideal, rays, spread_px).render())
    expected = opencv_pixels(camera, rays)
    np.testing.assert_allclose(expected, dot_pixels(camera), atol=1e-6)
    for x, y in expected:
        left, top = round(x) - 9, round(y) - 9
        window = gray[top : top + 19, left : left + 19].astype(float)
        v, u = np.indices(window.shape)
        found = np.array([left + (u * window).sum() / window.sum(), top + (v * window).sum() / window.sum()])
        assert np.hypot(*(found - (x, y))) < 0.05


@pytest.mark.parametrize("name", LENSES)
def test_rays_and_pixels_agree_with_opencv_over_the_whole_image(name):
    camera = LENSES[name]
    x, y = np.meshgrid(np.linspace(0, camera.width_px - 1, 31), np.linspace(0, camera.height_px - 1, 23))
    xy = np.column_stack([x.ravel(), y.ravel()])
    rays = unproject(camera, xy)
    np.testing.assert_allclose(opencv_pixels(camera, rays), xy, atol=1e-6)
    np.testing.assert_allclose(project(camera, rays), xy, atol=1e-6)


def test_rays_of_radtan_agree_with_opencv_s_slow_search():
    bent = np.random.default_rng(0).uniform(-0.6, 0.6, (200, 2))
    coefficients = LENSES["five"].distortion
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-13)
    slow = cv2.undistortPoints(bent[:, None], np.eye(3), np.array(coefficients), criteria=until)[:, 0]
    np.testing.assert_allclose(straightened(bent, "radtan", coefficients), slow, atol=1e-9)


def test_without_distortion_no_pixel_changes():
    camera = Intrinsics(96, 64, 70.0, 71.0, 40.3, 30.9, 30.0)
    lens = Lens(camera)
    rng = np.random.default_rng(0)
    shape = (lens.ideal.height_px, lens.ideal.width_px)
    gray, depth = rng.integers(0, 256, shape, dtype=np.uint8), rng.uniform(1, 9, shape).astype(np.float32)
    top, left = round(lens.ideal.cy - camera.cy), round(lens.ideal.cx - camera.cx)
    inner = np.s_[top : top + 64, left : left + 96]
    np.testing.assert_array_equal(lens.distort(gray), gray[inner])
    np.testing.assert_array_equal(lens.distort_depth(depth), depth[inner])
    np.testing.assert_array_equal(lens.distort_labels(gray), gray[inner])


@pytest.mark.parametrize("name", ["five", "fisheye"])
def test_depth_of_a_slanted_plane_is_exact(name):
    camera = LENSES[name]
    lens = Lens(camera)
    normal, offset_m = np.array([0.3, -0.2, 1.0]), 4.0

    def depth_of(rays):
        return offset_m / (rays @ normal[:2] + normal[2])

    c = lens.ideal
    x, y = np.meshgrid(np.arange(c.width_px), np.arange(c.height_px))
    ideal = depth_of(np.stack([(x - c.cx) / c.fx, (y - c.cy) / c.fy], axis=-1)).astype(np.float32)
    got = lens.distort_depth(ideal)
    x, y = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    rays = unproject(camera, np.stack([x, y], axis=-1).reshape(-1, 2).astype(float))
    expected = depth_of(rays).reshape(got.shape)
    near = (expected > 0) & (expected < 50)  # farther on, neighbours on the plane are metres apart
    np.testing.assert_allclose(got[near], expected[near], rtol=2e-5)


def test_depth_is_never_mixed_at_outlines():
    lens = Lens(EUROC)
    depth = np.full((lens.ideal.height_px, lens.ideal.width_px), 5.0, np.float32)
    depth[200:400, 300:500] = 2.0
    depth[:100] = 0.0
    assert set(np.unique(lens.distort_depth(depth).round(5))) == {np.float32(0), np.float32(2), np.float32(5)}


def depth_in_python(depth, at, ratio):
    out = np.empty(at.shape[:2])
    for row, column in np.ndindex(out.shape):
        x, y = (float(v) for v in at[row, column])
        left, top = int(x), int(y)
        four = depth[top : top + 2, left : left + 2].astype(float)
        if four.min() > 0 and four.max() <= ratio * four.min():
            wx, wy = [1 - (x - left), x - left], [1 - (y - top), y - top]
            out[row, column] = 1 / (np.outer(wy, wx) / four).sum()
        else:
            out[row, column] = depth[int(np.floor(y + 0.5)), int(np.floor(x + 0.5))]
    return out


def test_the_depth_kernel_agrees_with_python():
    rng = np.random.default_rng(3)
    depth = rng.choice(np.array([0, 2, 2.05, 2.09, 5], np.float32), (40, 50), p=[0.05, 0.3, 0.3, 0.3, 0.05])
    at = rng.uniform(1, 37, (30, 30, 2)).astype(np.float32)
    got = sample_depth(depth, at, np.float32(1.05))
    np.testing.assert_allclose(got, depth_in_python(depth, at, 1.05), rtol=1e-5)


def test_labels_are_those_of_the_nearest_pixel():
    rays = unproject(EUROC, np.array([[376.0, 240.0]]))
    lens = Lens(EUROC)
    labels = lens.distort_labels((Dots(lens.ideal, rays, np.ones(1)).render() > 100).astype(np.int32) - 1)
    assert labels.shape == (480, 752) and labels.dtype == np.int32 and set(np.unique(labels)) == {-1, 0}
    assert labels[240, 376] == 0 and labels[0, 0] == -1


def test_fine_texture_is_averaged_where_the_lens_compresses_it():
    camera = LENSES["fisheye"]
    lens = Lens(camera)
    shape = (lens.ideal.height_px, lens.ideal.width_px)
    checks = np.indices(shape).sum(axis=0) % 2 * 255
    seen = lens.distort(checks.astype(np.uint8))
    corner = seen[:40, :40].astype(float)
    assert corner.mean() == pytest.approx(127.5, abs=4) and corner.std() < 60


@pytest.mark.parametrize(
    "lens",
    [
        replace(EUROC, distortion=(-2.0, 0.0, 0.0, 0.0, 0.0)),
        replace(LENSES["fisheye"], fx=150.0, fy=150.0),
        replace(LENSES["fisheye"], distortion=(-3.0, 0.0, 0.0, 0.0)),
    ],
    ids=["folds", "sees behind", "folding fisheye"],
)
def test_a_lens_that_cannot_be_rendered_is_an_input_error(lens):
    with pytest.raises(InputError, match="camera: distortion"):
        Lens(lens)
