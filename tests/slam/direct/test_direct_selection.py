"""Selection of points: spread, in number, deterministic, and from nothing nothing."""

import cv2
import numpy as np
import pytest

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.direct.pyramid import Rectifier
from dslab.slam.direct.selection import SelectionConfig, select

WIDTH, HEIGHT = 320, 240
RECTIFIER = Rectifier(PinholeCamera(WIDTH, HEIGHT, 250.0, 250.0, 159.5, 119.5, 30.0))


def textured(gain, seed=0):
    """Texture whose contrast ``gain`` (H, W) varies over the image."""
    noise = np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.clip(120 + gain * smooth / smooth.std(), 0, 255).astype(np.uint8)


def test_points_are_as_many_as_wanted_and_stand_out():
    pyramid = RECTIFIER.pyramid(textured(30.0))
    for wanted in (300, 1500):
        found = select(pyramid, SelectionConfig(points=wanted))
        assert 0.6 * wanted <= len(found.xy) <= wanted
        assert len(np.unique(found.xy, axis=0)) == len(found.xy)
        gradient = np.hypot(pyramid.levels[0][..., 1], pyramid.levels[0][..., 2])
        chosen = gradient[found.xy[:, 1], found.xy[:, 0]][found.scale == 0]
        assert np.median(chosen) > 1.5 * np.nanmedian(gradient)
    again = select(pyramid, SelectionConfig(points=1500))
    np.testing.assert_array_equal(again.xy, found.xy)


def test_faint_regions_have_points_too():
    gain = np.full((HEIGHT, WIDTH), 8.0)
    gain[:, WIDTH // 2 :] = 50.0
    found = select(RECTIFIER.pyramid(textured(gain)), SelectionConfig(points=800))
    faint = (found.xy[:, 0] < WIDTH // 2).mean()
    assert 0.15 < faint < 0.6


def test_where_no_fine_gradient_stands_out_a_coarse_one_may():
    x = np.arange(WIDTH)
    soft = np.tile(120 + 60 * np.tanh((x - 160) / 6.0), (HEIGHT, 1)).astype(np.uint8)
    found = select(RECTIFIER.pyramid(soft), SelectionConfig(points=400, threshold=8.0))
    assert len(found.xy) and (found.scale > 0).any()
    assert (np.abs(found.xy[:, 0] - 160) < 30).all()


@pytest.mark.parametrize("value", [0, 128, 255])
def test_a_constant_image_has_none(value):
    found = select(RECTIFIER.pyramid(np.full((HEIGHT, WIDTH), value, np.uint8)))
    assert found.xy.shape == (0, 2) and found.scale.shape == (0,)
