"""Pyramids: known intensities and gradients, and what lies outside the image."""

import numpy as np
import pytest

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.direct.pyramid import Rectifier

PLAIN = PinholeCamera(160, 120, 150.0, 150.0, 79.5, 59.5, 30.0)
LENSES = {
    "radtan": PinholeCamera(160, 120, 150.0, 150.0, 79.5, 59.5, 30.0, (-0.3, 0.1, 0.001, -0.001, 0.0)),
    "equidistant": PinholeCamera(
        160, 120, 120.0, 120.0, 79.5, 59.5, 30.0, (0.03, -0.01, 0.0, 0.0), "equidistant"
    ),
    "residual": PinholeCamera(160, 120, 150.0, 150.0, 79.5, 59.5, 30.0, residual=(0.02, 0.01, 0.001, 0.002)),
}


def ramp(camera=PLAIN):
    y, x = np.mgrid[: camera.height_px, : camera.width_px]
    return np.clip(x + 0.5 * y, 0, 255).astype(np.uint8)


def test_levels_are_means_of_four_and_gradients_central_differences():
    image = np.random.default_rng(0).integers(0, 256, (120, 160)).astype(np.uint8)
    levels = Rectifier(PLAIN).pyramid(image).levels
    expected = image.astype(np.float64)
    for level in levels:
        np.testing.assert_array_equal(level[..., 0], expected.astype(np.float32))
        right, down = np.gradient(expected, axis=1), np.gradient(expected, axis=0)
        inside = np.s_[1:-1, 1:-1]
        np.testing.assert_allclose(level[(*inside, 1)], right[inside], atol=1e-4)
        np.testing.assert_allclose(level[(*inside, 2)], down[inside], atol=1e-4)
        border = np.ones(expected.shape, bool)
        border[inside] = False
        assert np.isnan(level[border, 1:]).all()
        h, w = (side // 2 for side in expected.shape)
        expected = expected[: 2 * h, : 2 * w].reshape(h, 2, w, 2).mean(axis=(1, 3))


def test_intrinsics_follow_the_centres_of_pixels():
    rectifier = Rectifier(PLAIN)
    point = np.array([0.2, -0.1])
    for level, (fx, fy, cx, cy) in enumerate(rectifier.intrinsics):
        fine = point * [150.0, 150.0] + [79.5, 59.5]
        np.testing.assert_allclose(point * [fx, fy] + [cx, cy], (fine + 0.5) / 2**level - 0.5)


@pytest.mark.parametrize("lens", LENSES)
def test_a_lens_is_taken_out(lens):
    """What the ideal camera sees, seen through the lens and taken back."""
    camera = LENSES[lens]
    y, x = np.mgrid[:120, :160]
    pixels = np.column_stack([x.ravel(), y.ravel()]).astype(np.float32)

    def shade(xy):
        return 120 + 60 * np.sin(xy[:, 0] / 9) * np.cos(xy[:, 1] / 11)

    taken = shade(camera.undistort_points(pixels)).reshape(120, 160)
    ideal = Rectifier(camera).pyramid(np.round(taken).astype(np.uint8)).levels[0][..., 0]
    seen = np.isfinite(ideal)
    assert seen.mean() > 0.7
    assert np.abs(ideal - shade(pixels).reshape(120, 160))[seen].max() < 2.5


@pytest.mark.parametrize("lens", LENSES)
def test_distorting_inverts_undistorting(lens):
    camera = LENSES[lens]
    taken = np.random.default_rng(0).uniform([5, 5], [154, 114], (200, 2)).astype(np.float32)
    np.testing.assert_allclose(camera.distort_points(camera.undistort_points(taken)), taken, atol=2e-3)


def test_an_image_too_small_is_said_to_be_and_a_wrong_one_refused():
    assert Rectifier(PinholeCamera(80, 60, 70.0, 70.0, 39.5, 29.5, 30.0)).is_too_small
    assert not Rectifier(PLAIN).is_too_small
    with pytest.raises(ValueError, match="120, 160"):
        Rectifier(PLAIN).pyramid(np.zeros((160, 120), np.uint8))
