"""Compositing of rendered parts against NumPy, bit by bit."""

import numpy as np
import pytest

from dslab.sim.rendering.compositing import metric_depth, put_nearer


@pytest.fixture
def parts():
    """Colours and reversed depth of two parts, the lowest row first, empty in places and equal in others."""
    rng = np.random.default_rng(0)
    made = []
    for _ in range(2):
        gray, zbuffer = rng.integers(0, 256, (6, 9), np.uint8), rng.random((6, 9), np.float32)
        zbuffer[rng.random((6, 9)) < 0.3] = 0
        made.append((np.repeat(gray[..., None], 3, axis=2), zbuffer))
    made[1][1][2:4] = made[0][1][2:4]
    return made


def test_the_nearer_part_shows_and_the_first_of_equally_near_ones(parts):
    gray, zbuffer = np.zeros((6, 9), np.uint8), np.zeros((6, 9), np.float32)
    expected_gray, expected_z = gray.copy(), zbuffer.copy()
    for rgb, part_z in parts:
        put_nearer(rgb, part_z, gray, zbuffer)
        nearer = part_z[::-1] > expected_z
        expected_gray = np.where(nearer, rgb[::-1, :, 0], expected_gray)
        expected_z = np.where(nearer, part_z[::-1], expected_z)
    np.testing.assert_array_equal(gray, expected_gray)
    np.testing.assert_array_equal(zbuffer, expected_z)
    assert (gray[zbuffer == 0] == 0).all() and (zbuffer == 0).any()


def test_depth_is_that_of_numpy_to_the_last_bit(parts):
    zbuffer = parts[0][1] * np.float32(1e-3)
    bias, offset_m = np.float32(3.3e-5), np.float32(0.0500017)
    expected = offset_m / (zbuffer + bias)
    expected[zbuffer == 0] = 0
    depth_m = metric_depth(zbuffer, bias, offset_m)
    assert depth_m.dtype == np.float32
    np.testing.assert_array_equal(depth_m, expected)
