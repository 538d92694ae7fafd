"""Textures: noise, dead leaves, text, levels, and every finish."""

from itertools import pairwise

import cv2
import numpy as np
import pytest

from dslab.scenarios.seeds import rng_for
from dslab.sim.worlds.materials.finishes import CLEAN_INSTEAD, FINISHES, FLOOR_FINISHES, WALL_FINISHES, paint
from dslab.sim.worlds.materials.textures import (
    BLACK_LEVEL,
    WHITE_LEVEL,
    dead_leaves,
    fit_levels,
    fractal_noise,
    multiply,
    text_block,
)


def test_noise_has_zero_mean_and_unit_deviation():
    noise = fractal_noise((300, 517), np.random.default_rng(0))
    assert noise.shape == (300, 517) and noise.dtype == np.float32
    assert abs(noise.mean()) < 1e-3
    assert noise.std() == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("shape", [(1, 1), (17, 1000)])
def test_noise_fits_any_shape(shape):
    noise = fractal_noise(shape, np.random.default_rng(0))
    assert noise.shape == shape and np.isfinite(noise).all()


def test_noise_falls_off_with_frequency_as_a_power_law():
    power = np.mean(
        [np.abs(np.fft.fft2(fractal_noise((256, 256), np.random.default_rng(k)))) ** 2 for k in range(6)],
        axis=0,
    )
    radius = np.hypot(*np.meshgrid(np.fft.fftfreq(256), np.fft.fftfreq(256)))
    edges = np.geomspace(4 / 256, 0.25, 8)
    bands = [power[(radius >= a) & (radius < b)].mean() for a, b in pairwise(edges)]
    slope = np.polyfit(np.log(np.sqrt(edges[:-1] * edges[1:])), np.log(bands), 1)[0]
    assert -3.5 < slope < -1.5
    assert (np.diff(bands) < 0).all()


def test_noise_is_heavy_tailed():
    noise = fractal_noise((512, 512), np.random.default_rng(0), 0.9).astype(float)
    assert np.mean(noise**4) > 3.5  # a Gaussian has 3


def test_dead_leaves_cover_more_with_more_of_them():
    covered = []
    for per_m2 in (20, 200):
        image = np.full((400, 400), 128, np.uint8)
        dead_leaves(image, 200.0, np.random.default_rng(1), per_m2, (0.01, 0.1), (0, 100))
        covered.append((image != 128).mean())
    assert 0 < covered[0] < covered[1] < 1


def test_dead_leaves_sizes_follow_a_cubic_law():
    # Nearly without overlap every shape is one blob, and of those above a size a quarter is above its double.
    image = np.zeros((4000, 4000), np.uint8)
    dead_leaves(image, 1000.0, np.random.default_rng(2), 60, (0.008, 0.2), (255, 255))
    _, _, stats, _ = cv2.connectedComponentsWithStats(image)
    extents = np.sort(stats[1:, 2:4].max(axis=1)).astype(float)
    above = [(extents > side).sum() for side in (20, 40, 80)]
    assert above[0] / above[1] == pytest.approx(4, rel=0.4)
    assert above[1] / above[2] == pytest.approx(4, rel=0.5)


def test_text_leaves_gaps_and_ink():
    image = np.full((120, 300), 230, np.uint8)
    text_block(image, np.random.default_rng(0), 6.0, 20)
    assert set(np.unique(image)) == {20, 230}
    assert 0.05 < (image == 20).mean() < 0.5


@pytest.mark.parametrize(("mean", "deviation"), [(118, 40), (240, 8)])
def test_levels_fit_mean_and_deviation_despite_clipping(mean, deviation):
    image = np.random.default_rng(0).integers(0, 256, (200, 200), dtype=np.uint8)
    fitted = fit_levels(image, mean, deviation)
    assert fitted.mean() == pytest.approx(mean, abs=0.5)
    assert deviation / 2 < fitted.std() < deviation + 1
    assert fitted.min() >= BLACK_LEVEL and fitted.max() <= WHITE_LEVEL


def test_a_constant_image_takes_the_mean_level():
    assert (fit_levels(np.full((9, 9), 200, np.uint8), 118, 40) == 118).all()


def test_multiply_stretches_the_gain_over_the_image():
    image = np.full((80, 60), 100, np.uint8)
    multiply(image, np.array([[0.5, 0.5], [1.5, 1.5]]))
    assert image[0].mean() == pytest.approx(50, abs=1) and image[-1].mean() == pytest.approx(150, abs=1)
    assert (np.diff(image[:, 5].astype(int)) >= 0).all()


@pytest.mark.parametrize("name", FINISHES)
def test_every_finish_has_its_mean_level_and_is_fixed_by_its_stream(name):
    first, again, other = (paint(name, (1.7, 1.2), 64.0, rng_for(seed, name)) for seed in (1, 1, 2))
    assert first.shape == (77, 109) and first.dtype == np.uint8
    assert first.mean() == pytest.approx(FINISHES[name].mean_level, abs=0.5)
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.3


@pytest.mark.parametrize("name", FINISHES)
def test_every_finish_paints_panels_of_any_size(name):
    for size_m, scale in (((0.03, 2.8), 128.0), ((2.0, 0.03), 128.0), ((0.01, 0.01), 20.0)):
        assert min(paint(name, size_m, scale, rng_for(3, name)).shape) >= 8


@pytest.mark.parametrize("name", [WALL_FINISHES[0], FLOOR_FINISHES[0], "ceiling"])
def test_large_surfaces_have_corners_everywhere(name):
    texture = paint(name, (2.0, 2.4), 160.0, rng_for(5, name))
    keypoints = cv2.ORB_create(5000, edgeThreshold=4).detect(texture)
    cells = {(int(k.pt[0] // 40), int(k.pt[1] // 40)) for k in keypoints}
    assert len(cells) > 0.9 * (texture.shape[0] // 40) * (texture.shape[1] // 40)


def corners(name, stream=5):
    """A texture, ORB's corners in it, and the bits between each and the most similar one elsewhere."""
    texture = cv2.GaussianBlur(paint(name, (2.0, 2.4), 128.0, rng_for(stream, name)), (0, 0), 1.0)
    orb = cv2.ORB_create(800, edgeThreshold=16, fastThreshold=15)
    found, descriptors = orb.detectAndCompute(texture, None)
    xy = np.array([k.pt for k in found]).reshape(-1, 2)
    if not len(xy):
        return texture, xy, np.empty(0)
    bits = np.unpackbits(descriptors, axis=1).astype(int)
    apart = (bits[:, None] != bits[None]).sum(-1)
    apart[np.linalg.norm(xy[:, None] - xy[None], axis=-1) < 20] = 999
    return texture, xy, apart.min(axis=1)


@pytest.mark.parametrize("worn", ["plaster", "concrete", "boards", "cabinet"])
def test_clean_surfaces_leave_parts_of_them_without_corners(worn):
    def share(name):
        texture, xy, _ = corners(name)
        return len({(int(x // 40), int(y // 40)) for x, y in xy}) / (texture.size / 40**2)

    assert share(CLEAN_INSTEAD[worn]) < 0.6 * share(worn)


@pytest.mark.parametrize("worn", ["parquet", "tiles"])
def test_fine_clean_surfaces_look_alike_in_many_places(worn):
    alike = [np.mean(corners(name)[2] < 40) for name in (worn, CLEAN_INSTEAD[worn])]
    assert alike[0] < 0.15 and alike[1] > 0.4
