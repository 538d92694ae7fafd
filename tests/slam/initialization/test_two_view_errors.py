"""Errors of matches agree with their definition, and the equations with the errors."""

import numpy as np
import pytest
from two_view_rays import FOCAL, errors_of, errors_reference, loss, matches_of, rigid, views

from dslab.slam.initialization._two_view_errors import motion_errors, normal_equations
from dslab.slam.initialization._two_view_refinement import TUKEY, moved, tangent
from dslab.slam.optimization._se3 import so3_exp


@pytest.mark.parametrize("seed", range(6))
def test_errors_agree_with_their_definition(seed):
    T, rays_1, rays_2, sigma = views(seed, n=60, noise_px=1.0, outliers=0.3)
    sigma *= np.random.default_rng(seed).uniform(0.5, 3.0, 60)
    for turn in ((0.0, 0, 0), (0.1, -0.2, 0.05), (0.0, 3.0, 0.0)):
        other = rigid(T[:3, 3] + 0.3 * np.array(turn), turn)
        for got, expected in zip(
            errors_of(other, rays_1, rays_2, sigma),
            errors_reference(other, rays_1, rays_2, sigma),
            strict=True,
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
    # The rotation by 180 degrees about the baseline, which has the same epipolar lines.
    twisted = T.copy()
    twisted[:3, :3] = so3_exp(*(np.pi * T[:3, 3])) @ T[:3, :3]
    off, behind = errors_of(twisted, rays_1, rays_2, sigma)
    assert np.abs(off).max() < 1e-4 and (behind < -1.0).mean() > 0.95


def test_the_error_of_a_point_behind_is_its_distance_to_the_image_of_infinity():
    T, rays_1, rays_2, sigma = views(2, noise_px=0.5, direction=(1, 0.2, 0.1), depth=(50, 200))
    T[:3, 3] *= -1
    off, behind = errors_of(T, rays_1, rays_2, sigma)
    turned = np.column_stack([rays_1, np.ones(len(rays_1))]) @ T[:3, :3].T
    way = rays_2 - turned[:, :2] / turned[:, 2:]
    at_back = behind < 0
    assert at_back.sum() > 150
    expected = np.linalg.norm(way, axis=1) / np.sqrt(2) / sigma
    np.testing.assert_allclose(np.hypot(off, behind)[at_back], expected[at_back], rtol=0.1, atol=0.05)


def test_the_error_is_smooth_at_infinity():
    T, rays_1, *_ = views(3, n=40)
    turned = np.column_stack([rays_1, np.ones(40)]) @ T[:3, :3].T
    infinity = turned[:, :2] / turned[:, 2:]
    nearer = T[:2, 3] - infinity * T[2, 3]
    nearer /= np.linalg.norm(nearer, axis=1)[:, None]
    sigma = np.full(40, 1 / FOCAL)
    for way in (-1e-9, 0.0, 1e-9):
        errors = errors_of(T, rays_1, infinity + way * nearer, sigma)
        assert np.abs(errors).max() < 1e-5


def equations_of(T, matches, c2, weight_c2):
    R, t = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
    H, g = np.zeros((5, 5)), np.zeros(5)
    costs = normal_equations(R, t, *tangent(t), matches, c2, weight_c2, H, g)
    return costs, H, g


def jacobian(T, matches, step=1e-6):
    """(5, 2, N) by central differences."""
    R, t = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
    ahead, back = np.empty((2, 5, 2, matches.shape[1]))
    for p in range(5):
        for way, out in ((step, ahead[p]), (-step, back[p])):
            motion_errors(*moved(R, t, way * np.eye(5)[p]), matches, out)
    return (ahead - back) / (2 * step)


@pytest.mark.parametrize("direction", [(1, 0.2, 0.1), (-0.4, 0.6, -1), (0.4, -0.6, 1)])
@pytest.mark.parametrize("turned", [False, True])
def test_the_equations_agree_with_reweighted_squares(direction, turned):
    T, *seen = views(11, noise_px=1.0, direction=direction, outliers=0.2)
    matches = matches_of(*seen)
    at = rigid(T[:3, 3] + (0.05, -0.1, 0.02), (0.01, 0.02, -0.03))
    if turned:  # many points behind, some behind the second camera
        at = rigid(-T[:3, 3], (0.0, 1.2, 0.3))
    errors = errors_of(at, *seen)
    c2 = (3 * TUKEY) ** 2 if not turned else 1e6
    J = jacobian(at, matches)
    weight = np.maximum(1 - (errors**2).sum(axis=0) / c2, 0) ** 2
    J[:, :, weight == 0] = 0.0
    costs, H, g = equations_of(at, matches, TUKEY**2, c2)
    assert costs[0] == pytest.approx(loss(*errors).sum())
    assert costs[1] == pytest.approx(c2 / TUKEY**2 * loss(*(errors * TUKEY / np.sqrt(c2))).sum())
    expected = np.einsum("pei,qei,i->pq", J, J, weight)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert (np.abs(np.tril(H - expected)) < 2e-3 * size).all()
    scale = np.sqrt(np.diag(expected) * (weight * (errors**2).sum(axis=0)).sum())
    assert (np.abs(g - np.einsum("pei,ei,i->p", J, errors, weight)) < 2e-3 * scale).all()


def test_matches_beyond_the_bound_have_no_influence():
    _, *seen = views(3, noise_px=0.5)
    far = rigid((1, 0, 0), (0.0, 0.0, 1.0))
    costs, H, g = equations_of(far, matches_of(*seen), 1e-6, 1e-6)
    assert costs[0] == pytest.approx(len(seen[2]) * 1e-6 / 3, rel=0.02)
    assert np.abs(H).max() < 0.02 * np.abs(equations_of(far, matches_of(*seen), 1e9, 1e9)[1]).max()
    assert np.isfinite(g).all()


def test_the_equations_are_finite_for_all_motions():
    _, *seen = views(5, n=60)
    matches = matches_of(*seen)
    matches[:4, :5] = 0.0
    for turn in ((0, 0, 0), (0, np.pi / 2, 0), (np.pi / 2, 0, 0), (0, 3.0, 0), (0, 0, 3.0)):
        for direction in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1)):
            costs, H, g = equations_of(rigid(direction, turn), matches, 1e12, TUKEY**2)
            assert np.isfinite(costs).all() and np.isfinite(H).all() and np.isfinite(g).all()
