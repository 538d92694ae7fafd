"""Sprites drawn over frames, and the passers-by among them."""

import numpy as np
import pytest

from dslab.sim.degradations.passers_by import POSES, person, vehicle
from dslab.sim.degradations.sprites import draw_behind, fill_share, filled, smooth_outline


def drawn_in_python(gray, alpha, left, top, scale, shape):
    """The sprite alone on a view, by explicit bilinear interpolation."""
    light, open_share = np.zeros(shape), np.ones(shape)
    span = int(np.ceil(gray.shape[1] * scale)) + 1
    for row in range(shape[0]):
        for step in range(span):
            column = (int(np.floor(left)) + step) % max(shape[1], span)
            x, y = (int(np.floor(left)) + step - left) / scale, (row - top) / scale
            inside = 0 <= x <= gray.shape[1] - 1.001 and 0 <= y <= gray.shape[0] - 1.001
            if not inside or column >= shape[1]:
                continue
            i, j, v, u = int(y), int(x), y % 1, x % 1
            weights = np.outer([1 - v, v], [1 - u, u])
            cover = (weights * alpha[i : i + 2, j : j + 2]).sum() / 255
            light[row, column] = cover * (weights * gray[i : i + 2, j : j + 2]).sum()
            open_share[row, column] = 1 - cover
    return light, open_share


@pytest.mark.parametrize(("left", "top", "scale"), [(3.3, 2.6, 1.0), (-7.2, -4.5, 1.7), (33.0, 10.1, 0.6)])
def test_drawing_agrees_with_python(left, top, scale):
    rng = np.random.default_rng(0)
    gray, alpha = rng.integers(0, 256, (2, 20, 14), dtype=np.uint8)
    light, open_share = np.zeros((30, 40), np.float32), np.ones((30, 40), np.float32)
    draw_behind(gray, alpha, left, top, scale, light, open_share)
    expected = drawn_in_python(gray, alpha, left, top, scale, (30, 40))
    np.testing.assert_allclose(light, expected[0], atol=2e-3)
    np.testing.assert_allclose(open_share, expected[1], atol=1e-5)


def test_earlier_sprites_hide_later_ones():
    light, open_share = np.zeros((30, 40), np.float32), np.ones((30, 40), np.float32)
    whole = np.full((10, 10), 255, np.uint8)
    for level in (200, 50):
        draw_behind(np.full((10, 10), level, np.uint8), whole, 5.0, 5.0, 1.0, light, open_share)
    assert light[8, 8] == 200 and open_share[8, 8] == 0
    assert open_share[0, 0] == 1


def test_an_outline_is_smooth_and_keeps_its_place():
    square = np.array([(10.0, 10), (50, 10), (50, 50), (10, 50)])
    rounded = smooth_outline(square)
    turns = np.diff(np.unwrap(np.arctan2(*np.diff(np.vstack([rounded, rounded[:2]]), axis=0).T)))
    assert np.abs(turns).max() < np.pi / 4 and len(rounded) == 32
    cover = filled((60, 60), rounded)
    assert cover[30, 30] == 1 and cover[11, 11] == 0
    assert 0.75 * 1600 < cover.sum() < 1600
    assert ((cover > 0.05) & (cover < 0.95)).sum() > 20


@pytest.mark.parametrize("drawn", ["person", "car", "van"])
def test_passers_by_have_a_shape_a_soft_outline_and_a_texture(drawn):
    rng = np.random.default_rng(1)
    sprite = person(90.0, rng) if drawn == "person" else vehicle(90.0, drawn == "van", rng)
    assert len(sprite.gray) == (POSES if drawn == "person" else 1)
    for gray, alpha in zip(sprite.gray, sprite.alpha, strict=True):
        on = alpha == 255
        assert 0.15 < on.mean() < 0.95
        assert not on[0, 0] and not on[0, -1]
        assert ((alpha > 10) & (alpha < 245)).sum() > 50
        assert gray[on].std() > 8
    if drawn == "person":
        steps = [
            np.abs(a.astype(int) - b).mean() for a, b in zip(sprite.alpha, sprite.alpha[1:], strict=False)
        ]
        assert min(steps) > 0.5
        # The legs move, the head stays.
        head = sprite.alpha[:, : sprite.alpha.shape[1] // 8]
        assert np.abs(np.diff(head.astype(int), axis=0)).max() == 0


def test_filling_stops_at_the_share_or_at_the_most():
    drawn = iter([0.2, 0.35, 0.6, 0.9])
    assert fill_share(0.5, lambda: next(drawn), 9).tolist() == [0, 0.2, 0.35, 0.6]
    assert len(fill_share(0.5, lambda: 0.1, 3)) == 4
    assert fill_share(0.0, lambda: 1.0, 3).tolist() == [0]
