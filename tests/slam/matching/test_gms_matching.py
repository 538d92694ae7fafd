"""GMS keeps correct matches and removes wrong ones, for any motion of the keypoints."""

from dataclasses import replace

import numpy as np
import pytest
from slam_scenes import CAMERA, VIEW, PointWorld, make_frame, rigid

from dslab.slam.core.frame import Features, FrameFeatures
from dslab.slam.matching.brute_force import match_brute_force
from dslab.slam.matching.gms import GmsConfig, match_gms

WORLD = PointWorld(seed=5, points=9000, reach=(-8.0, 8.0))
SIZE_PX = (CAMERA.width_px, CAMERA.height_px)


def sight(i, T_cam_world, seed=0, bits=25):
    return WORLD.see(i, T_cam_world, np.random.default_rng([seed, i]), noise_px=0.4, bits=bits)


def two_views(turn_deg=14.0, seed=0):
    """Two views of the world, the second rotated by 120 px and slightly moved."""
    one, two = sight(0, rigid(), seed), sight(1, rigid((0.05, 0, 0), (0, turn_deg, 0)), seed)
    return one, two


def count_right(pairs, one, two):
    shown = one.ids[pairs[:, 0]]
    return ((shown >= 0) & (shown == two.ids[pairs[:, 1]])).sum()


def share_right(pairs, one, two):
    return count_right(pairs, one, two) / len(pairs)


def match(one, two, **settings):
    return match_gms(one.frame.features, two.frame.features, SIZE_PX, GmsConfig(**settings))


@pytest.mark.parametrize("seed", range(3))
def test_most_correct_matches_and_few_others_are_kept(seed):
    one, two = two_views(seed=seed)
    a, b = one.frame.features, two.frame.features
    nearest = match_brute_force(a.descriptors, b.descriptors, 256, 1e3)
    kept = match(one, two)
    assert share_right(nearest, one, two) < 0.85
    assert share_right(kept, one, two) > 0.97
    assert count_right(kept, one, two) > 0.8 * count_right(nearest, one, two)


def test_unrelated_images_have_few_matches():
    rng = np.random.default_rng(0)
    a, b = (make_frame(i, rng, n=1000).features for i in range(2))
    assert len(match_gms(a, b, SIZE_PX)) < 20


def test_a_higher_threshold_keeps_fewer_matches():
    one, two = two_views()
    kept = [len(match(one, two, threshold_factor=factor)) for factor in (3.0, 6.0, 12.0)]
    assert kept[0] >= kept[1] > kept[2]


def test_matches_are_one_to_one_in_order_and_the_same_every_time():
    pairs = match(*two_views())
    assert pairs.dtype == np.int32
    assert (np.diff(pairs[:, 0]) > 0).all()
    assert len(np.unique(pairs[:, 1])) == len(pairs)
    np.testing.assert_array_equal(pairs, match(*two_views()))


def test_coarse_levels_can_be_left_out():
    one, two = two_views()
    octave = one.frame.features.octave
    every, fine = match(one, two), match(one, two, max_octave=2)
    np.testing.assert_array_equal(fine, every[octave[every[:, 0]] <= 2])
    assert 0 < len(fine) < len(every)


def test_a_rotated_image_is_matched_on_request():
    """The second image is the first upside down."""
    one, _ = two_views()
    f = one.frame.features
    turned = replace(f, xy_image=np.float32([CAMERA.width_px - 1, CAMERA.height_px - 1]) - f.xy_image)
    assert len(match_gms(f, turned, SIZE_PX)) < 0.1 * len(f)
    assert len(match_gms(f, turned, SIZE_PX, GmsConfig(with_rotation=True))) > 0.8 * len(f)


def test_a_frame_without_keypoints_matches_nothing():
    one, _ = two_views()
    rng = np.random.default_rng(0)
    empty = make_frame(0, rng, n=0).features
    for a, b in ((empty, one.frame.features), (one.frame.features, empty), (empty, empty)):
        assert match_gms(a, b, SIZE_PX).shape == (0, 2)


def test_keypoints_on_the_image_border_are_accepted():
    rng = np.random.default_rng(1)
    n = 600
    xy = rng.uniform((0, 0), (639, 479), (n, 2)).astype(np.float32)
    xy[:150, 0], xy[150:300, 1], xy[300:400, 0], xy[400:500, 1] = 639, 479, 0, 0
    features = Features(
        xy,
        np.zeros(n, np.int32),
        np.zeros(n, np.float32),
        np.ones(n, np.float32),
        rng.integers(0, 2**63, (n, 4)).astype(np.uint64),
    )
    frame = FrameFeatures.build(0, 0.0, features, CAMERA, VIEW)
    # Undistorted positions may lie far outside of the image; they are not used.
    frame = replace(frame, xy=frame.xy * 10.0 - 3000.0)
    pairs = match_gms(frame, frame, SIZE_PX)
    assert len(pairs) > 0.8 * n
    np.testing.assert_array_equal(pairs[:, 0], pairs[:, 1])
