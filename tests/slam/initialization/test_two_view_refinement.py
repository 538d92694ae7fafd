"""Refined motions are minima of the robust cost, for any start, outliers and noise."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from two_view_rays import FOCAL, angle_deg, errors_of, errors_reference, loss, rigid, views

from dslab.slam.initialization._two_view_refinement import TUKEY, moved, refined, tangent
from dslab.slam.optimization._se3 import so3_exp


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


def off_by(T, rng, direction=0.05, turn=0.005):
    R, t = moved(
        T[:3, :3].copy(),
        T[:3, 3].copy(),
        np.concatenate([turn * rng.normal(size=3), direction * rng.normal(size=2)]),
    )
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = R, t
    return start


@pytest.mark.parametrize("seed", range(3))
def test_the_cost_agrees_with_scipy(seed):
    T, rays_1, rays_2, sigma = views(seed, noise_px=0.7, outliers=0.15)
    start = off_by(T, np.random.default_rng(seed), 0.01, 0.001)
    found = refined(start, rays_1, rays_2, sigma, iterations=50)

    def at(step):
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = moved(start[:3, :3].copy(), start[:3, 3].copy(), step)
        return errors_reference(motion, rays_1, rays_2, sigma)

    def tukey(e2):
        left = np.maximum(1 - e2 / TUKEY**2, 0)
        return np.array([TUKEY**2 / 3 * (1 - left**3), left**2, -2 / TUKEY**2 * left])

    oracle = least_squares(lambda step: np.hypot(*at(step)), np.zeros(5), loss=tukey, x_scale=0.01)
    assert found.cost <= 2 * oracle.cost * (1 + 1e-3)
    np.testing.assert_allclose(
        found.errors.T, errors_reference(found.T_2_1, rays_1, rays_2, sigma), atol=1e-6
    )
    np.testing.assert_allclose(found.costs, loss(*found.errors.T), atol=1e-9)
    np.testing.assert_allclose(found.T_2_1[:3, :3] @ found.T_2_1[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.norm(found.T_2_1[:3, 3]) == pytest.approx(1.0)


def test_perfect_matches_give_the_motion_back():
    for seed in range(5):
        T, rays_1, rays_2, sigma = views(seed)
        start = off_by(T, np.random.default_rng(seed), 0.05, 0.002)
        found = refined(start, rays_1, rays_2, sigma, widest=32.0, iterations=30)
        np.testing.assert_allclose(found.T_2_1, T, atol=1e-6)


def test_outliers_have_no_influence():
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


def test_a_wider_loss_converges_from_farther_away():
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


def test_the_direction_can_be_kept():
    T, rays_1, rays_2, sigma = views(4, noise_px=0.5)
    start = off_by(T, np.random.default_rng(0), 0.1, 0.01)
    found = refined(start, rays_1, rays_2, sigma, turn_only=True)
    np.testing.assert_allclose(found.T_2_1[:3, 3], start[:3, 3], rtol=0, atol=1e-15)
    assert found.information.shape == (3, 3)
    free = refined(start, rays_1, rays_2, sigma)
    assert free.cost < found.cost < loss(*errors_of(start, rays_1, rays_2, sigma)).sum()


def test_the_information_predicts_the_scatter():
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


def test_uninformative_matches_give_finite_results():
    rays = np.zeros((120, 2))
    found = refined(rigid((1, 0, 0), (0, 0, 0)), rays, rays.copy(), np.full(120, 1 / FOCAL))
    assert np.isfinite(found.T_2_1).all() and found.cost == 0.0
    assert np.isfinite(np.linalg.inv(found.information)).all()
