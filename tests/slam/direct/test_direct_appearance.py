"""Patches of a surface in another view: the kernel's twin, right and wrong motions, empty views."""

import numpy as np
import pytest
from test_direct_alignment import HEIGHT, RECTIFIER, WIDTH, motion, view

from dslab.slam.direct._appearance_kernels import correlations
from dslab.slam.direct.appearance import Surface, compare, pooled
from dslab.slam.direct.selection import select

BASELINE = [0.15, 0.05, -0.1, 0.02, -0.03, 0.05]


@pytest.fixture(scope="module")
def surface():
    image, depth = view(np.eye(4))
    pyramid = RECTIFIER.pyramid(image)
    xy = select(pyramid).xy[::7].astype(float)
    at = xy.astype(int)
    return Surface(pyramid, xy, 1 / depth[at[:, 1], at[:, 0]])


def looks(surface, T, other=None, least=0.7):
    other = RECTIFIER.pyramid(view(motion(BASELINE), 0.6, 30)[0]) if other is None else other
    return compare(surface, other, RECTIFIER.intrinsics, T, least)


def twin(level, camera, uv, inverse_depth, pattern, intensity, T, offsets, reach, least_contrast):
    """Largest correlation about each place, patch by patch."""
    fx, fy, cx, cy = camera
    best = np.full((len(uv), len(offsets)), np.nan)
    for i, centre in enumerate(uv):
        pixels = centre + pattern
        rays = np.column_stack([(pixels - (cx, cy)) / (fx, fy), np.ones(len(pixels))])
        X = rays @ T[:3, :3].T + inverse_depth[i] * T[:3, 3]
        if (X[:, 2] <= 1e-6).any() or not intensity[i].std() >= least_contrast:
            continue
        at = X[:, :2] / X[:, 2:] * (fx, fy) + (cx, cy)
        for m, offset in enumerate(offsets):
            for shift in np.ndindex(2 * reach + 1, 2 * reach + 1):
                u, v = (at + offset + np.array(shift)[::-1] - reach).T
                if (
                    min(u.min(), v.min()) < 0
                    or u.max() >= level.shape[1] - 1
                    or v.max() >= level.shape[0] - 1
                ):
                    continue
                c, r = u.astype(int), v.astype(int)
                p, q, image = u - c, v - r, level[..., 0].astype(float)
                value = (1 - q) * ((1 - p) * image[r, c] + p * image[r, c + 1])
                value += q * ((1 - p) * image[r + 1, c] + p * image[r + 1, c + 1])
                if np.isnan(value).any():
                    continue
                found = np.corrcoef(value, intensity[i])[0, 1] if value.std() >= least_contrast else 0.0
                best[i, m] = np.fmax(best[i, m], found)
    return best


def test_the_kernel_equals_its_twin():
    rng = np.random.default_rng(4)
    level = rng.uniform(0, 255, (60, 80, 3)).astype(np.float32)
    level[20:25, 30:40], level[40:55, 50:70] = np.nan, 90
    uv, d = rng.uniform([-5, -5], [85, 65], (150, 2)), rng.uniform(0.1, 2, 150)
    d[0] = 1e3
    pattern = np.array([[x, y] for y in (-1, 0, 1) for x in (-1, 0, 1)], float)
    intensity = rng.uniform(0, 255, (150, 9))
    intensity[3], intensity[4] = 50, np.nan
    T, camera = motion([0.05, -0.04, -0.1, 0.05, 0.02, -0.1]), np.array([70.0, 75.0, 40.0, 30.0])
    offsets = np.array([[0.0, 0.0], [3.5, -2.0]])
    best = np.empty((150, 2))
    correlations(level, camera, uv, d, pattern, intensity, T, offsets, 1, 2.0, best)
    expected = twin(level, camera, uv, d, pattern, intensity, T, offsets, 1, 2.0)
    assert 20 < np.isnan(expected).sum() < 200 and (expected == 0).any()
    np.testing.assert_allclose(best, expected, atol=1e-9)


def test_a_surface_is_seen_where_the_right_motion_says_and_nowhere_else(surface):
    right = looks(surface, motion(BASELINE))
    assert right.told > 100 and right.excess > 0.9 and right.chance < 0.3
    for wrong in ([0, 0, 0, 0, 0.05, 0], [0, 0, 0, 0.04, 0, 0], [0.1, 0, 0, 0, 0, 0], [0, 0.15, 0, 0, 0, 0]):
        assert looks(surface, motion(wrong) @ motion(BASELINE)).excess < 0.3
    longer = motion(BASELINE)
    longer[:3, 3] *= 1.6
    assert looks(surface, longer).excess < 0.5


def test_what_shows_nothing_tells_nothing(surface):
    flat = RECTIFIER.pyramid(np.full((HEIGHT, WIDTH), 255, np.uint8))
    assert looks(surface, np.eye(4), flat).alike == 0
    blank = Surface(flat, surface.xy, surface.inverse_depth)
    assert looks(blank, np.eye(4)).told == 0 and looks(blank, np.eye(4)).excess == 0
    assert looks(surface, motion([0, 0, 0, 0, 3.1, 0])).told == 0
    empty = Surface(surface.pyramid, np.empty((0, 2)), np.empty(0))
    assert pooled([looks(empty, np.eye(4)), looks(blank, np.eye(4))]).told == 0


def test_comparisons_are_put_together_by_their_patches(surface):
    right, wrong = looks(surface, motion(BASELINE)), looks(surface, motion([0.3, 0, 0, 0, 0, 0]))
    both = pooled([right, wrong])
    assert both.told == right.told + wrong.told
    assert both.alike * both.told == pytest.approx(right.alike * right.told + wrong.alike * wrong.told)
