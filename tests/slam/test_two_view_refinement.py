"""Refined motions are minima of the cost they claim, whatever the start, the outliers and the noise."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from slam._two_view_refinement import TUKEY, motion_errors, moved, refined, tangent
from slam.optimization._se3 import so3_exp

FOCAL = 500.0


def unit(v):
    return np.asarray(v, float) / np.linalg.norm(v)


def angle_deg(a, b):
    return np.degrees(np.arccos(np.clip(unit(a) @ unit(b), -1, 1)))


def rigid(direction, turn):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = so3_exp(*map(float, turn)), unit(direction)
    return T


def views(seed, n=200, noise_px=0.0, direction=None, depth=(5, 20), outliers=0.0):
    """T_2_1, rays of both views and the noise, for points at a depth in baselines."""
    rng = np.random.default_rng(seed)
    T = rigid(rng.normal(size=3) if direction is None else direction, rng.normal(0, 0.05, 3))
    rays_1 = rng.uniform(-0.5, 0.5, (n, 2))
    points = np.column_stack([rays_1, np.ones(n)]) * rng.uniform(*depth, n)[:, None]
    moved_points = points @ T[:3, :3].T + T[:3, 3]
    rays_2 = moved_points[:, :2] / moved_points[:, 2:]
    rays = [r + noise_px / FOCAL * rng.normal(size=r.shape) for r in (rays_1, rays_2)]
    wrong = int(outliers * n)
    rays[1][:wrong] = rng.uniform(-0.5, 0.5, (wrong, 2))
    return T, rays[0], rays[1], np.full(n, max(noise_px, 0.1) / FOCAL)


def errors_of(T, rays_1, rays_2, sigma):
    out = np.empty(len(sigma)), np.empty(len(sigma))
    motion_errors(
        np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3]), rays_1, rays_2, sigma, *out
    )
    return out


def errors_twin(T, rays_1, rays_2, sigma):
    """The errors match by match, from the essential matrix and the vanishing point of the ray."""
    R, t = T[:3, :3], T[:3, 3]
    E = np.cross(np.eye(3), t) @ R
    off, behind = [], []
    for p, q, s in zip(rays_1, rays_2, sigma, strict=True):
        h1, h2 = np.append(p, 1.0), np.append(q, 1.0)
        gradient2 = ((E @ h1)[:2] ** 2).sum() + ((E.T @ h2)[:2] ** 2).sum() + s**2 * (E[:2, :2] ** 2).sum()
        off.append(h2 @ E @ h1 / np.sqrt(gradient2) / s)
        ray = R @ h1
        if ray[2] <= 0:
            behind.append(-1 / s)
            continue
        infinity = ray / ray[2]
        end = h2 if t[2] >= 0 else infinity
        nearer = t[:2] - end[:2] * t[2]
        length = np.sqrt(2 * (nearer @ nearer + s**2 * (E[:2, :2] ** 2).sum()))
        behind.append(min(0.0, (h2 - infinity)[:2] @ nearer / length / s))
    return np.array(off), np.array(behind)


def loss(off, behind):
    """Tukey's loss as in textbooks, so scaled that it is the square for small errors."""
    e2 = (off**2 + behind**2) / TUKEY**2
    return TUKEY**2 / 3 * np.where(e2 < 1, 1 - (1 - np.minimum(e2, 1)) ** 3, 1.0)


# -- errors --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_errors_agree_with_their_definition(seed):
    T, rays_1, rays_2, sigma = views(seed, n=60, noise_px=1.0, outliers=0.3)
    sigma *= np.random.default_rng(seed).uniform(0.5, 3.0, 60)
    for turn in ((0.0, 0, 0), (0.1, -0.2, 0.05), (0.0, 3.0, 0.0)):
        other = rigid(T[:3, 3] + 0.3 * np.array(turn), turn)
        for got, expected in zip(
            errors_of(other, rays_1, rays_2, sigma), errors_twin(other, rays_1, rays_2, sigma), strict=True
        ):
            np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("direction", [(1, 0, 0), (0.2, 0.1, -1), (0.2, 0.1, 1), None])
def test_perfect_matches_have_no_error_under_the_true_motion_only(direction):
    T, rays_1, rays_2, sigma = views(1, direction=direction)
    off, behind = errors_of(T, rays_1, rays_2, sigma)
    assert np.abs(off).max() < 1e-6 and np.abs(behind).max() == 0.0
    mirrored = T.copy()
    mirrored[:3, 3] *= -1
    off, behind = errors_of(mirrored, rays_1, rays_2, sigma)
    assert np.abs(off).max() < 1e-6 and (behind < -1.0).mean() > 0.95
    # The turn by 180 degrees about the baseline, which has the same epipolar lines.
    twisted = T.copy()
    twisted[:3, :3] = so3_exp(*(np.pi * T[:3, 3])) @ T[:3, :3]
    off, behind = errors_of(twisted, rays_1, rays_2, sigma)
    assert np.abs(off).max() < 1e-4 and (behind < -1.0).mean() > 0.95


def test_a_point_behind_is_as_wrong_as_its_image_is_from_that_of_infinity():
    T, rays_1, rays_2, sigma = views(2, noise_px=0.5, direction=(1, 0.2, 0.1), depth=(50, 200))
    T[:3, 3] *= -1
    off, behind = errors_of(T, rays_1, rays_2, sigma)
    turned = np.column_stack([rays_1, np.ones(len(rays_1))]) @ T[:3, :3].T
    way = rays_2 - turned[:, :2] / turned[:, 2:]
    at_back = behind < 0
    assert at_back.sum() > 150
    expected = np.linalg.norm(way, axis=1) / np.sqrt(2) / sigma
    np.testing.assert_allclose(np.hypot(off, behind)[at_back], expected[at_back], rtol=0.1, atol=0.05)


def test_a_point_at_infinity_is_no_edge():
    T, rays_1, *_ = views(3, n=40)
    turned = np.column_stack([rays_1, np.ones(40)]) @ T[:3, :3].T
    infinity = turned[:, :2] / turned[:, 2:]
    nearer = T[:2, 3] - infinity * T[2, 3]
    nearer /= np.linalg.norm(nearer, axis=1)[:, None]
    sigma = np.full(40, 1 / FOCAL)
    for way in (-1e-9, 0.0, 1e-9):
        errors = errors_of(T, rays_1, infinity + way * nearer, sigma)
        assert np.abs(errors).max() < 1e-5


def test_the_tangent_and_the_moved_direction_are_unit_vectors():
    rng = np.random.default_rng(0)
    for _ in range(20):
        T = rigid(rng.normal(size=3), rng.normal(size=3))
        t = T[:3, 3].copy()
        basis = np.column_stack([t, *tangent(t)])
        np.testing.assert_allclose(basis.T @ basis, np.eye(3), atol=1e-12)
        step = rng.normal(0, 1e-3, 5)
        R_moved, t_moved = moved(T[:3, :3].copy(), t, step)
        assert np.linalg.norm(t_moved) == pytest.approx(1.0)
        np.testing.assert_allclose(t_moved - t, basis[:, 1:] @ step[3:], atol=1e-5)
        np.testing.assert_allclose(R_moved, so3_exp(*step[:3]) @ T[:3, :3], atol=1e-12)


# -- refinement ----------------------------------------------------------------------------------------------


def off_by(T, rng, direction=0.05, turn=0.005):
    R, t = moved(
        T[:3, :3].copy(),
        T[:3, 3].copy(),
        np.concatenate([turn * rng.normal(size=3), direction * rng.normal(size=2)]),
    )
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = R, t
    return start


@pytest.mark.parametrize("seed", range(5))
def test_the_cost_is_as_low_as_an_oracle_gets_it(seed):
    T, rays_1, rays_2, sigma = views(seed, noise_px=0.7, outliers=0.15)
    start = off_by(T, np.random.default_rng(seed), 0.01, 0.001)
    found = refined(start, rays_1, rays_2, sigma, iterations=50)

    def at(step):
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = moved(start[:3, :3].copy(), start[:3, 3].copy(), step)
        return errors_twin(motion, rays_1, rays_2, sigma)

    def tukey(e2):
        left = np.maximum(1 - e2 / TUKEY**2, 0)
        return np.array([TUKEY**2 / 3 * (1 - left**3), left**2, -2 / TUKEY**2 * left])

    oracle = least_squares(lambda step: np.hypot(*at(step)), np.zeros(5), loss=tukey, x_scale=0.01)
    assert found.cost <= 2 * oracle.cost * (1 + 1e-3)
    np.testing.assert_allclose(found.errors.T, errors_twin(found.T_2_1, rays_1, rays_2, sigma), atol=1e-6)
    np.testing.assert_allclose(found.costs, loss(*found.errors.T), atol=1e-9)
    np.testing.assert_allclose(found.T_2_1[:3, :3] @ found.T_2_1[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.norm(found.T_2_1[:3, 3]) == pytest.approx(1.0)


def test_perfect_matches_give_the_motion_back():
    for seed in range(5):
        T, rays_1, rays_2, sigma = views(seed)
        start = off_by(T, np.random.default_rng(seed), 0.05, 0.002)
        found = refined(start, rays_1, rays_2, sigma, widest=32.0, iterations=30)
        np.testing.assert_allclose(found.T_2_1, T, atol=1e-6)


def test_outliers_do_not_count():
    T, rays_1, rays_2, sigma = views(7, n=300, noise_px=0.5)
    alone = refined(T, rays_1, rays_2, sigma)
    rng = np.random.default_rng(0)
    with_outliers = refined(
        T,
        np.concatenate([rays_1, rng.uniform(-0.5, 0.5, (120, 2))]),
        np.concatenate([rays_2, rng.uniform(1.5, 2.5, (120, 2))]),
        np.concatenate([sigma, sigma[:120]]),
    )
    np.testing.assert_allclose(with_outliers.T_2_1, alone.T_2_1, atol=1e-3)
    np.testing.assert_allclose(with_outliers.costs[300:], TUKEY**2 / 3)


def test_a_wide_start_reaches_farther():
    def reached(widest):
        count = 0
        for seed in range(20):
            T, rays_1, rays_2, sigma = views(seed, noise_px=0.5, direction=(1, 0.3, -0.3))
            start = off_by(T, np.random.default_rng(seed), 0.5, 0.05)
            found = refined(start, rays_1, rays_2, sigma, widest=widest, iterations=15)
            count += angle_deg(found.T_2_1[:3, 3], T[:3, 3]) < 3
        return count

    assert reached(8.0) >= 15
    assert reached(8.0) > reached(1.0)


def test_only_the_turn_is_refined_where_asked():
    T, rays_1, rays_2, sigma = views(4, noise_px=0.5)
    start = off_by(T, np.random.default_rng(0), 0.1, 0.01)
    found = refined(start, rays_1, rays_2, sigma, turn_only=True)
    np.testing.assert_allclose(found.T_2_1[:3, 3], start[:3, 3], rtol=0, atol=1e-15)
    assert found.information.shape == (3, 3)
    free = refined(start, rays_1, rays_2, sigma)
    assert free.cost < found.cost < loss(*errors_of(start, rays_1, rays_2, sigma)).sum()


def test_the_information_foretells_the_scatter():
    T, rays_1, rays_2, sigma = views(5, noise_px=0.5)
    perfect = views(5)
    rng = np.random.default_rng(1)
    steps = []
    for _ in range(150):
        noisy = [r + rng.normal(0, sigma[0], r.shape) for r in perfect[1:3]]
        t = refined(T, *noisy, sigma).T_2_1[:3, 3]
        steps.append([t @ axis for axis in tangent(T[:3, 3].copy())])
    foretold = np.linalg.inv(refined(T, rays_1, rays_2, sigma).information)[3:, 3:]
    ratio = np.linalg.eigvalsh(np.linalg.solve(foretold, np.cov(np.transpose(steps))))
    assert (ratio > 0.6).all() and (ratio < 1.7).all()


def test_matches_that_say_nothing_are_survived():
    rays = np.zeros((120, 2))
    found = refined(rigid((1, 0, 0), (0, 0, 0)), rays, rays.copy(), np.full(120, 1 / FOCAL))
    assert np.isfinite(found.T_2_1).all() and found.cost == 0.0
    assert np.isfinite(np.linalg.inv(found.information)).all()
