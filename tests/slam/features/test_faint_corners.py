"""Corners in surfaces of nearly no contrast, found where the image itself has none."""

from dataclasses import fields

import cv2
import numpy as np
import pytest
from slam_scenes import CAMERA

from dslab.slam.core.frame import Features
from dslab.slam.dual.paper import paper_config
from dslab.slam.features.faint import Amplifier, noise_of
from dslab.slam.features.finder import FeatureFinder
from dslab.slam.features.orb import OrbConfig, OrbExtractor
from dslab.slam.matching.brute_force import match_brute_force

WIDTH, HEIGHT = 640, 480


def extract(image, **config):
    return OrbExtractor(image.shape[1], image.shape[0], OrbConfig(**config)).extract(image)


def wall(contrast, seed=0, noise=1.5):
    """A textured wall of one standard deviation in grey levels, and each seed's own noise of the sensor."""
    texture = cv2.GaussianBlur(np.random.default_rng(7).normal(size=(HEIGHT, WIDTH)), (0, 0), 2.5)
    signal = 120 + contrast * texture / texture.std()
    signal += np.random.default_rng(seed).normal(0, noise, signal.shape)
    return np.clip(np.rint(signal), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("sigma", "contrast"), [(1.0, 0.0), (2.5, 0.0), (6.0, 0.0), (1.5, 3.0), (2.5, 20.0)])
def test_the_noise_of_an_image_is_known_beside_its_texture(sigma, contrast):
    assert noise_of(wall(contrast, noise=sigma)) == pytest.approx(sigma, rel=0.12)


def test_an_image_without_noise_has_that_of_rounding():
    assert noise_of(np.full((HEIGHT, WIDTH), 90, np.uint8)) == 0.29


@pytest.mark.parametrize("sigma", [0.0, 0.7, 1.5, 4.0])
def test_noise_alone_has_hardly_any_corners(sigma):
    with_faint, without = (extract(wall(0.0, noise=sigma), faint_share=share) for share in (1.0, 0.0))
    assert len(with_faint) - len(without) <= 20


def test_a_wall_of_three_grey_levels_is_recognised_through_other_noise():
    def right(share):
        a, b = (extract(wall(3.0, seed), faint_share=share) for seed in (1, 2))
        pairs = match_brute_force(a.descriptors, b.descriptors, 50, 0.8)
        return int((np.abs(a.xy[pairs[:, 0]] - b.xy[pairs[:, 1]]).max(axis=1) < 3).sum()), len(pairs)

    found, pairs = right(1.0)
    assert found > 200 and found > 0.9 * pairs
    assert right(0.0)[0] < found / 5


def test_an_image_with_enough_corners_stays_as_it_is():
    image = wall(40.0)
    a, b = extract(image), extract(image, faint_share=0.0)
    assert all(np.array_equal(getattr(a, c.name), getattr(b, c.name)) for c in fields(Features))


def test_faint_corners_lie_where_there_are_no_others_and_fill_up_what_is_missing():
    image = wall(3.0)
    image[:, : WIDTH // 16] = wall(60.0)[:, : WIDTH // 16]
    clear = extract(image, faint_share=0.0)
    assert 100 < len(clear) < 900
    for share in (0.9, 1.0):
        both = extract(image, faint_share=share)
        assert (np.diff(both.octave) >= 0).all()
        kept = {tuple(xy) for xy in both.xy}
        assert all(tuple(xy) in kept for xy in clear.xy)
        assert len(both) <= max(len(clear), round(1000 * share))
        added = both.xy[[tuple(xy) not in {tuple(c) for c in clear.xy} for xy in both.xy]]
        assert len(added) > 100 and (added[:, 0] > WIDTH / 16 - 60).all()


def test_shading_and_lamps_do_not_saturate_the_wall():
    shade = 0.12 * (np.arange(WIDTH) - WIDTH / 2)
    shaded = np.clip(wall(3.0) + shade, 0, 255).astype(np.uint8)
    shaded[:60, :60] = 255
    sizes = [(HEIGHT, WIDTH), (HEIGHT // 2 - 3, WIDTH // 2 - 1)]
    levels = [np.zeros(size, np.uint8) for size in sizes]
    Amplifier(sizes).amplify(shaded, 7, levels)
    for level in levels:
        inside = level[100:, 100:]
        assert inside.std() > 2 * shaded[100:, 100:].std(axis=0).mean()
        assert ((inside == 0) | (inside == 255)).mean() < 0.01


def test_no_map_is_begun_from_faint_corners():
    finder = FeatureFinder(CAMERA, OrbConfig(n_features=300), 5.0)
    image = wall(3.0)[: CAMERA.height_px, : CAMERA.width_px]
    assert len(finder.find(image, dense=False)) > 150
    assert len(finder.find(image, dense=True)) == len(extract(image, n_features=1500, faint_share=0.0)) < 150


def test_the_system_of_the_paper_has_none():
    orb = paper_config(CAMERA).orb
    assert len(OrbExtractor(WIDTH, HEIGHT, orb).extract(wall(3.0))) < 150 < len(extract(wall(3.0)))
