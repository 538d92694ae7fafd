"""The search finds every motion that explains the matches."""

from itertools import pairwise

import numpy as np
import pytest

from dslab.slam.initialization._two_view_refinement import TUKEY, refined
from dslab.slam.initialization._two_view_search import distinct, motions_around, search_motions
from dslab.slam.optimization._se3 import so3_exp

FOCAL = 500.0


def rigid(direction, turn=(0.0, 0.0, 0.0)):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = so3_exp(*map(float, turn)), np.asarray(direction) / np.linalg.norm(direction)
    return T


def views(T, depth, rng, n=300, noise_px=0.3, outliers=0.0):
    rays_1 = rng.uniform(-0.5, 0.5, (n, 2))
    homogeneous = np.column_stack([rays_1, np.ones(n)])
    points = homogeneous * depth(homogeneous)[:, None] @ T[:3, :3].T + T[:3, 3]
    rays = [r + noise_px / FOCAL * rng.normal(size=(n, 2)) for r in (rays_1, points[:, :2] / points[:, 2:])]
    wrong = int(outliers * n)
    rays[1][:wrong] = rng.uniform(-0.5, 0.5, (wrong, 2))
    return rays[0], rays[1], np.full(n, 1 / FOCAL)


def angle_deg(a, b):
    return np.degrees(np.arccos(np.clip(a @ b, -1, 1)))


@pytest.mark.parametrize("outliers", [0.0, 0.3])
def test_the_true_motion_is_found_from_any_start(outliers):
    for seed in range(6):
        rng = np.random.default_rng(seed)
        T = rigid(rng.normal(size=3), rng.normal(0, 0.05, 3))
        matches = views(T, lambda h, rng=rng: rng.uniform(5, 20, len(h)), rng, outliers=outliers)
        start = rigid(rng.normal(size=3), T[:3, :3][[2, 0, 1], [1, 2, 0]] + rng.normal(0, 0.02, 3))
        minima, noise = search_motions([start], *matches)
        assert angle_deg(minima[0].T_2_1[:3, 3], T[:3, 3]) < 1.5
        assert noise == pytest.approx(0.3, rel=0.25)
        assert all(a.cost <= b.cost for a, b in pairwise(minima))


def test_both_explanations_of_a_plane_are_found():
    """In motion towards a tilted plane, direction and normal may be exchanged."""
    rng = np.random.default_rng(0)
    T = rigid((0, 0, -1))
    normal = np.array([0.5, -0.3, 1.0])
    matches = views(T, lambda h: 8.0 / (h @ normal), rng)
    other = -normal / np.linalg.norm(normal)
    minima, _ = search_motions([T], *matches)
    directions = [m.T_2_1[:3, 3] for m in minima]
    assert min(angle_deg(t, T[:3, 3]) for t in directions) < 3
    assert min(angle_deg(t, other) for t in directions) < 3
    assert minima[1].cost < 1.1 * minima[0].cost


def test_duplicates_of_a_motion_are_removed():
    rng = np.random.default_rng(1)
    T = rigid((1, 0.2, 0.1), (0.02, 0.01, 0))
    matches = views(T, lambda h: rng.uniform(5, 20, len(h)), rng)
    near = rigid(T[:3, 3] + (0, 0.02, 0), (0.02, 0.01, 0))
    motions = [
        refined(start, *matches, iterations=k) for k, start in ((0, near), (0, T), (20, near), (20, T))
    ]
    far = refined(rigid((0, 0, 1)), *matches, iterations=0)
    kept = distinct([*motions, far])
    assert len(kept) == 2
    assert kept[0].cost == min(m.cost for m in motions)
    assert kept[1] is far


def test_motions_around_keep_their_angle_and_include_the_worst_determined():
    rng = np.random.default_rng(2)
    for direction in ((1, 0.2, 0.1), (0.1, 0.2, -1), (0.3, 1, 0.5)):
        T = rigid(direction, (0.02, 0.01, 0))
        matches = views(T, lambda h: rng.uniform(5, 20, len(h)), rng)
        minima, noise = search_motions([T], *matches)
        rays_1, rays_2, sigma = matches
        around = motions_around(minima[0], 10.0, rays_1, rays_2, noise * sigma)
        angles = [angle_deg(m.T_2_1[:3, 3], minima[0].T_2_1[:3, 3]) for m in around]
        np.testing.assert_allclose(angles, 10.0, atol=1e-6)
        costs = [m.cost for m in around]
        assert min(costs) > minima[0].cost
        half = len(costs) // 2
        assert min(costs[0], costs[half]) < np.median(costs)


def test_random_matches_give_finite_results():
    rng = np.random.default_rng(3)
    matches = rng.uniform(-0.5, 0.5, (150, 2)), rng.uniform(-0.5, 0.5, (150, 2)), np.full(150, 1 / FOCAL)
    minima, noise = search_motions([rigid((1, 0, 0))], *matches)
    assert np.isfinite(noise) and noise > 0
    assert minima[0].cost > 0.5 * 150 * TUKEY**2 / 3
