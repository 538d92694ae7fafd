"""The Sim(3) algebra against scipy's matrix functions, the pose graph against a dense solver."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares

from dslab.slam.optimization.pose_graph import optimize_pose_graph
from dslab.slam.optimization.sim3_algebra import (
    adjoint_sim3,
    exp_sim3,
    hat,
    inverse_jacobians,
    invert_sim3,
    log_sim3,
    scales,
)

SIZES = [0.0, 1e-9, 1e-4, 0.3, 1.5]


def twists(n, size, seed=0):
    rng = np.random.default_rng(seed)
    return size * rng.uniform(-1, 1, (n, 7))


def generator(twist):
    A = np.zeros((4, 4))
    A[:3, :3] = hat(twist[None, :3])[0] + twist[6] * np.eye(3)
    A[:3, 3] = twist[3:6]
    return A


@pytest.mark.parametrize("size", SIZES)
def test_exp_is_the_matrix_exponential(size):
    x = twists(20, size)
    np.testing.assert_allclose(exp_sim3(x), [expm(generator(t)) for t in x], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("kept", [[0, 1, 2], [3, 4, 5], [6], [0, 1, 2, 3, 4, 5]])
def test_exp_of_twists_with_zero_parts(kept):
    x = np.zeros((5, 7))
    x[:, kept] = twists(5, 1.0)[:, kept]
    np.testing.assert_allclose(exp_sim3(x), [expm(generator(t)) for t in x], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("size", SIZES)
def test_log_inverts_exp(size):
    x = twists(20, size)
    np.testing.assert_allclose(log_sim3(exp_sim3(x)), x, atol=1e-10)


def test_inverse_and_adjoint():
    S, x = exp_sim3(twists(10, 1.0)), twists(10, 0.8, seed=1)
    np.testing.assert_allclose(invert_sim3(S) @ S, np.broadcast_to(np.eye(4), (10, 4, 4)), atol=1e-12)
    turned = np.einsum("nij,nj->ni", adjoint_sim3(S), x)
    np.testing.assert_allclose(S @ exp_sim3(x) @ invert_sim3(S), exp_sim3(turned), atol=1e-10)


@pytest.mark.parametrize("size", [0.0, 1e-3, 0.5])
def test_the_jacobians_are_the_derivatives_of_the_logarithm(size):
    x = twists(6, size)
    left, right = inverse_jacobians(x)
    S, h = exp_sim3(x), 1e-6
    for k in range(7):
        step = np.zeros((1, 7))
        step[0, k] = h
        for J, plus, minus in (
            (left, exp_sim3(step) @ S, exp_sim3(-step) @ S),
            (right, S @ exp_sim3(step), S @ exp_sim3(-step)),
        ):
            numeric = (log_sim3(plus) - log_sim3(minus)) / (2 * h)
            np.testing.assert_allclose(J[:, :, k], numeric, atol=1e-7)


def drifting_loop(n, seed=0, drift=0.02):
    """A loop of cameras with drift in rotation, position and scale, and the edge that closes it."""
    rng = np.random.default_rng(seed)
    truth = np.empty((n, 4, 4))
    for k in range(n):
        angle = 2 * np.pi * k / n
        truth[k] = exp_sim3(np.array([[0, 0, angle, 0, 0, 0, 0]]))[0]
        truth[k, :3, 3] = -truth[k, :3, :3] @ (5 * np.cos(angle), 5 * np.sin(angle), 0)
    edges = [(k + 1, k) for k in range(n - 1)] + [(k + 3, k) for k in range(0, n - 3, 2)]
    pairs = np.array(edges)
    exact = truth[pairs[:, 0]] @ invert_sim3(truth[pairs[:, 1]])
    measured = exp_sim3(drift * rng.normal(size=(len(pairs), 7))) @ exact
    start = truth.copy()
    for k in range(n - 1):
        start[k + 1] = measured[k] @ start[k]
    pairs = np.vstack([pairs, [0, n - 1]])
    measured = np.concatenate([measured, (truth[0] @ invert_sim3(truth[-1:]))])
    fixed = np.arange(n) == 0
    return truth, start, pairs, measured, fixed


def test_the_minimum_agrees_with_a_dense_solver():
    _, start, edges, measured, fixed = drifting_loop(12)

    def residual(x):
        S = start.copy()
        S[1:] = exp_sim3(x.reshape(-1, 7)) @ start[1:]
        return log_sim3(invert_sim3(measured) @ S[edges[:, 0]] @ invert_sim3(S[edges[:, 1]])).ravel()

    theirs = least_squares(residual, np.zeros(7 * 11), method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    ours = optimize_pose_graph(start, edges, measured, fixed, iterations=50)
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-6)
    assert ours.cost_before == pytest.approx(0.5 * float((residual(np.zeros(77)) ** 2).sum()))
    assert ours.cost < 0.1 * ours.cost_before
    best = start.copy()
    best[1:] = exp_sim3(theirs.x.reshape(-1, 7)) @ start[1:]
    np.testing.assert_allclose(ours.S_cam_map, best, atol=1e-4)


def test_the_drift_of_a_loop_is_corrected():
    truth, start, edges, measured, fixed = drifting_loop(200, drift=0.003)
    after = optimize_pose_graph(start, edges, measured, fixed).S_cam_map
    centres = [-np.linalg.solve(S[:, :3, :3], S[:, :3, 3:])[:, :, 0] for S in (truth, start, after)]
    error = [np.linalg.norm(c - centres[0], axis=1).mean() for c in centres[1:]]
    assert error[1] < error[0] / 3
    assert np.abs(np.log(scales(after))).mean() < np.abs(np.log(scales(start))).mean() / 3


def test_a_consistent_graph_and_fixed_nodes_are_unchanged():
    truth, _, edges, _, fixed = drifting_loop(30)
    exact = truth[edges[:, 0]] @ invert_sim3(truth[edges[:, 1]])
    still = optimize_pose_graph(truth, edges, exact, fixed)
    np.testing.assert_allclose(still.S_cam_map, truth, atol=1e-9)
    _, start, edges, measured, fixed = drifting_loop(30)
    fixed[7] = True
    after = optimize_pose_graph(start, edges, measured, fixed).S_cam_map
    np.testing.assert_array_equal(after[fixed], start[fixed])


def test_misuse_is_refused():
    _, start, edges, measured, fixed = drifting_loop(10)
    with pytest.raises(ValueError, match="fixed node"):
        optimize_pose_graph(start, edges, measured, np.zeros(10, bool))
    with pytest.raises(ValueError, match="outside"):
        optimize_pose_graph(start, edges + 5, measured, fixed)
