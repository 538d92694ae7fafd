from dataclasses import astuple, dataclass, replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from dslab.slam.optimization import _sim3_kernels as kernels
from dslab.slam.optimization.sim3 import (
    depth_information,
    horn_sim3,
    optimize_sim3,
    ransac_sim3,
    sim3_decompose,
    sim3_inverse,
    sim3_matrix,
)

INTRINSICS = (500.0, 510.0, 320.0, 240.0)


@dataclass
class Pairs:
    points_1: np.ndarray
    points_2: np.ndarray
    pixels_1: np.ndarray
    pixels_2: np.ndarray
    sigma2_1: np.ndarray
    sigma2_2: np.ndarray

    def arguments(self):
        return (*astuple(self), *INTRINSICS)

    def kernel_arrays(self):
        return (
            self.points_1, self.points_2, self.pixels_1, self.pixels_2,
            1 / self.sigma2_1, 1 / self.sigma2_2, np.array(INTRINSICS),
        )  # fmt: skip


def project(points):
    return points[:, :2] / points[:, 2:] * INTRINSICS[:2] + INTRINSICS[2:]


def problem(seed=0, n=150, wrong=0, pixel_noise=0.0, depth_noise=0.0, plane=False, baseline=0.5):
    """True (s, R, t) and pairs, of which the first ``wrong`` are mismatched."""
    rng = np.random.default_rng(seed)
    s, R = float(rng.uniform(0.3, 3)), Rotation.from_rotvec(rng.normal(0, 0.2, 3)).as_matrix()
    t = baseline * rng.normal(size=3)
    points_1 = rng.uniform([-3, -2, 4], [3, 2, 9], (n, 3))
    if plane:
        points_1[:, 2] = 6 + 0.2 * points_1[:, 0]
    points_2 = (points_1 - t) @ R / s
    sigma2 = 1.2 ** (2.0 * rng.integers(0, 8, (2, n)))
    pixels = [
        project(p) + pixel_noise * rng.normal(size=(n, 2)) * np.sqrt(v)[:, None]
        for p, v in zip((points_1, points_2), sigma2, strict=True)
    ]
    points_1, points_2 = (p * (1 + depth_noise * rng.normal(size=(n, 1))) for p in (points_1, points_2))
    points_2[:wrong] = points_2[rng.permutation(wrong)] + rng.normal(0, 0.5 / s, (wrong, 3))
    return (s, R, t), Pairs(points_1, points_2, *pixels, *sigma2)


def assert_similar(result, truth, rel):
    s, R, t = truth
    assert result.s == pytest.approx(s, rel=rel)
    np.testing.assert_allclose(result.R, R, atol=rel)
    np.testing.assert_allclose(result.t, t, atol=10 * rel)


# -- matrices ----------------------------------------------------------------------------------------------


def test_matrix_inverse_and_decomposition_agree():
    (s, R, t), _ = problem()
    S = sim3_matrix(s, R, t)
    s_again, R_again, t_again = sim3_decompose(S)
    assert s_again == pytest.approx(s)
    np.testing.assert_allclose(R_again, R, atol=1e-14)
    np.testing.assert_array_equal(t_again, t)
    np.testing.assert_allclose(sim3_inverse(S), np.linalg.inv(S), atol=1e-13)
    point = np.array([1.0, -2.0, 3.0])
    np.testing.assert_allclose(S @ [*point, 1], [*(s * R @ point + t), 1])


@pytest.mark.parametrize("linear", [np.diag([1.0, 1, -1]), np.zeros((3, 3)), np.diag([1.0, np.nan, 1.0])])
def test_an_invalid_similarity_is_refused(linear):
    with np.errstate(invalid="ignore"), pytest.raises(ValueError, match="not a similarity"):
        sim3_decompose(np.block([[linear, np.zeros((3, 1))], [np.eye(4)[3:]]]))


def test_a_step_is_the_exponential_to_first_order():
    (s, R, t), _ = problem()
    S, out = sim3_matrix(s, R, t), np.eye(4)
    twist = 1e-4 * np.random.default_rng(0).normal(size=7)
    kernels.retract_sim3(S, twist, out)
    (x, y, z), scale = twist[3:6], twist[6]
    generator = np.zeros((4, 4))
    generator[:3, :3] = [[scale, -z, y], [z, scale, -x], [-y, x, scale]]
    generator[:3, 3] = twist[:3]
    np.testing.assert_allclose(out, expm(generator) @ S, atol=3e-7)
    assert not np.allclose(out, S, atol=1e-5)
    sim3_decompose(out)


# -- closed form -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("turn", [0.0, 1e-6, 0.3, np.pi / 2, np.pi - 1e-6, np.pi])
@pytest.mark.parametrize("n", [3, 4, 50])
def test_horn_recovers_an_exact_similarity(turn, n):
    rng = np.random.default_rng(n)
    axis = rng.normal(size=3)
    R = Rotation.from_rotvec(turn * axis / np.linalg.norm(axis)).as_matrix()
    b = rng.normal(size=(n, 3)) + 5.0
    s, R_found, t = horn_sim3(0.37 * b @ R.T + [1.0, -2.0, 3.0], b)
    assert s == pytest.approx(0.37)
    np.testing.assert_allclose(R_found, R, atol=1e-10)
    np.testing.assert_allclose(t, [1.0, -2.0, 3.0], atol=1e-9)


def test_horn_recovers_the_similarity_of_coplanar_points():
    (s, R, t), pairs = problem(plane=True)
    found = horn_sim3(pairs.points_1, pairs.points_2)
    assert found[0] == pytest.approx(s)
    np.testing.assert_allclose(found[1], R, atol=1e-10)
    np.testing.assert_allclose(found[2], t, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_horn_is_the_least_squares_solution(seed):
    """NumPy reference: the SVD form of Umeyama, 1991, which is another way to the same minimum."""
    _, pairs = problem(seed, n=30, depth_noise=0.2)
    a, b = pairs.points_1, pairs.points_2
    a_0, b_0 = a - a.mean(axis=0), b - b.mean(axis=0)
    u, d, vt = np.linalg.svd(a_0.T @ b_0)
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    R = u * sign @ vt
    s = (d * sign).sum() / (b_0**2).sum()
    found = horn_sim3(a, b)
    assert found[0] == pytest.approx(s)
    np.testing.assert_allclose(found[1], R, atol=1e-10)
    np.testing.assert_allclose(found[2], a.mean(axis=0) - s * R @ b.mean(axis=0), atol=1e-9)


def test_horn_never_gives_a_reflection():
    rng = np.random.default_rng(0)
    b = rng.normal(size=(20, 3))
    _, R, _ = horn_sim3(b * [1, 1, -1], b)
    assert np.linalg.det(R) == pytest.approx(1.0)


@pytest.mark.parametrize("case", ["two", "line", "point", "nan", "lengths"])
def test_horn_refuses_degenerate_points(case):
    b = np.random.default_rng(0).normal(size=(10, 3))
    a = 2 * b
    if case == "two":
        a, b = a[:2], b[:2]
    elif case == "line":
        a = b = np.outer(np.arange(10.0), [1.0, 2.0, 3.0])
    elif case == "point":
        a = b = np.ones((10, 3))
    elif case == "nan":
        a[0, 0] = np.nan
    else:
        a = a[:5]
    with pytest.raises(ValueError):
        horn_sim3(a, b)


# -- RANSAC ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("plane", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_half_the_pairs_may_be_wrong(seed, plane):
    truth, pairs = problem(seed, wrong=75, pixel_noise=0.7, depth_noise=0.01, plane=plane)
    result = ransac_sim3(*pairs.arguments(), np.random.default_rng(0))
    assert result.success
    assert result.inliers[:75].mean() < 0.03
    assert result.inliers[75:].mean() > 0.85
    assert_similar(result, truth, 0.03)
    s, R, t = result.s, result.R, result.t
    back = project(s * pairs.points_2 @ R.T + t) - pairs.pixels_1
    forth = project((pairs.points_1 - t) @ R / s) - pairs.pixels_2
    errors = [(e**2).sum(axis=1) / v for e, v in ((back, pairs.sigma2_1), (forth, pairs.sigma2_2))]
    np.testing.assert_array_equal(result.inliers, np.max(errors, axis=0) <= 9.21)


def test_perfect_pairs_are_all_inliers():
    truth, pairs = problem()
    result = ransac_sim3(*pairs.arguments(), np.random.default_rng(0))
    assert result.success and result.inliers.all()
    assert_similar(result, truth, 1e-9)


def test_scale_can_be_fixed():
    (_, R, t), pairs = problem()
    pairs = replace(pairs, points_2=(pairs.points_1 - t) @ R)
    result = ransac_sim3(*pairs.arguments(), np.random.default_rng(0), fixed_scale=True)
    assert result.success and result.s == 1.0
    assert_similar(result, (1.0, R, t), 1e-9)


def test_unrelated_points_are_refused():
    _, pairs = problem(wrong=150)
    result = ransac_sim3(*pairs.arguments(), np.random.default_rng(0))
    assert not result.success
    assert result.inliers.sum() < 20


@pytest.mark.parametrize("n", [0, 2, 19])
def test_too_few_pairs_are_refused(n):
    _, pairs = problem()
    few = Pairs(*(a[:n] for a in astuple(pairs)))
    for result in (
        ransac_sim3(*few.arguments(), np.random.default_rng(0)),
        optimize_sim3(1.0, np.eye(3), np.zeros(3), *few.arguments()),
    ):
        assert not result.success
        assert result.inliers.shape == (n,) and not result.inliers.any()


def test_collinear_points_are_refused():
    _, pairs = problem()
    line = np.outer(np.linspace(1, 2, 150), [0.5, 0.2, 4.0])
    pairs = replace(pairs, points_1=line, points_2=line, pixels_1=project(line), pixels_2=project(line))
    assert not ransac_sim3(*pairs.arguments(), np.random.default_rng(0)).success


def test_non_finite_points_are_left_out():
    truth, pairs = problem(wrong=0)
    pairs.points_1[:10] = np.nan
    pairs.points_2[10:20, 1] = np.inf
    result = ransac_sim3(*pairs.arguments(), np.random.default_rng(0))
    assert result.success and not result.inliers[:20].any() and result.inliers[20:].all()
    refined = optimize_sim3(result.s, result.R, result.t, *pairs.arguments())
    assert refined.success
    assert_similar(refined, truth, 1e-6)


def test_the_same_stream_gives_the_same_bits():
    _, pairs = problem(wrong=75, pixel_noise=0.7, depth_noise=0.01)
    first, second = (ransac_sim3(*pairs.arguments(), np.random.default_rng(3)) for _ in range(2))
    assert first.s == second.s
    np.testing.assert_array_equal(first.t, second.t)
    np.testing.assert_array_equal(first.inliers, second.inliers)


# -- refinement --------------------------------------------------------------------------------------------


def stepped(S, twist):
    out = np.eye(4)
    kernels.retract_sim3(S, np.ascontiguousarray(twist), out)
    return out


def whitened(S, pairs, depth_weight):
    """Residuals of one row per pair: two reprojections and the depth."""
    s, R, t = sim3_decompose(S)
    moved = s * pairs.points_2 @ R.T + t
    back = (project(moved) - pairs.pixels_1) / np.sqrt(pairs.sigma2_1)[:, None]
    forth = (project((pairs.points_1 - t) @ R / s) - pairs.pixels_2) / np.sqrt(pairs.sigma2_2)[:, None]
    depth = np.sqrt(depth_weight) * np.log(moved[:, 2] / pairs.points_1[:, 2])
    return [back, forth, depth[:, None]]


def robust(residuals, huber2):
    """Residuals whose squares add up to the Huber cost, and their IRLS weights."""
    chi2 = (residuals**2).sum(axis=1)
    if huber2 <= 0:
        return residuals, np.ones_like(chi2)
    rho = np.where(chi2 > huber2, 2 * np.sqrt(huber2 * chi2) - huber2, chi2)
    weights = np.where(chi2 > huber2, np.sqrt(huber2 / np.maximum(chi2, 1e-300)), 1.0)
    return residuals * np.sqrt(rho / np.maximum(chi2, 1e-300))[:, None], weights


@pytest.mark.parametrize("huber2", [0.0, 10.0])
@pytest.mark.parametrize("depth_weight", [0.0, 2500.0])
@pytest.mark.parametrize("fixed_scale", [False, True])
def test_linearisation_agrees_with_finite_differences(huber2, depth_weight, fixed_scale):
    (s, R, t), pairs = problem(n=25, wrong=5, pixel_noise=1.0, depth_noise=0.02)
    S = stepped(sim3_matrix(s, R, t), np.full(7, 0.01))
    H, gradient = np.empty((7, 7)), np.empty(7)
    active = np.arange(25) != 7
    cost = kernels.linearise(
        S, *pairs.kernel_arrays(), active, depth_weight, huber2, fixed_scale, H, gradient
    )  # fmt: skip
    some = Pairs(*(a[active] for a in astuple(pairs)))
    expected_cost, expected_H, expected_gradient = 0.0, np.zeros((7, 7)), np.zeros(7)
    for k in range(3):
        r = whitened(S, some, depth_weight)[k]
        J = np.stack(
            [
                (
                    whitened(stepped(S, 1e-6 * e), some, depth_weight)[k]
                    - whitened(stepped(S, -1e-6 * e), some, depth_weight)[k]
                )
                / 2e-6
                for e in np.eye(7)
            ],
            axis=-1,
        )
        scaled, w = robust(r, huber2)
        expected_cost += (scaled**2).sum()
        expected_H += np.einsum("n,nij,nik->jk", w, J, J)
        expected_gradient += np.einsum("n,nij,ni->j", w, J, r)
    if fixed_scale:
        expected_H[6], expected_H[:, 6], expected_gradient[6] = 0, 0, 0
        expected_H[6, 6] = 1
    assert cost == pytest.approx(expected_cost, rel=1e-10)
    np.testing.assert_allclose(np.tril(H), np.tril(expected_H), rtol=1e-5, atol=1e-2)
    np.testing.assert_allclose(gradient, expected_gradient, rtol=1e-5, atol=1e-2)


@pytest.mark.parametrize("depth_weight", [0.0, 2500.0])
@pytest.mark.parametrize("huber2", [0.0, 10.0])
def test_refinement_reaches_the_cost_of_scipy(huber2, depth_weight):
    (s, R, t), pairs = problem(pixel_noise=1.0, depth_noise=0.02)
    start = stepped(sim3_matrix(s, R, t), np.full(7, 0.01))

    def residuals(twist):
        parts = whitened(stepped(start, twist), pairs, depth_weight)
        return np.concatenate([robust(part, huber2)[0].ravel() for part in parts])

    oracle = least_squares(residuals, np.zeros(7), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    S = start.copy()
    active = np.ones(150, np.bool_)
    cost = kernels.refine(S, *pairs.kernel_arrays(), active, depth_weight, huber2, False, 50)
    assert cost == pytest.approx(2 * oracle.cost, rel=1e-6)


def test_perfect_pairs_give_back_the_truth():
    truth, pairs = problem()
    S = stepped(sim3_matrix(*truth), np.full(7, 0.02))
    result = optimize_sim3(*sim3_decompose(S), *pairs.arguments())
    assert result.success and result.inliers.all()
    assert_similar(result, truth, 1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_refinement_improves_ransac_and_drops_outliers(seed):
    truth, pairs = problem(seed, wrong=60, pixel_noise=0.7, depth_noise=0.01)
    rough = ransac_sim3(*pairs.arguments(), np.random.default_rng(0))
    result = optimize_sim3(rough.s, rough.R, rough.t, *pairs.arguments())
    assert result.success
    assert result.inliers[:60].mean() < 0.04 and result.inliers[60:].mean() > 0.9
    assert_similar(result, truth, 0.01)
    assert np.abs(result.R - truth[1]).max() < np.abs(rough.R - truth[1]).max() + 1e-3


@pytest.mark.parametrize("seed", range(4))
def test_one_frame_in_two_maps_has_its_scale_from_the_depths(seed):
    """Without a baseline between the cameras only depths determine the scale."""
    (s, R, t), pairs = problem(seed, pixel_noise=0.7, depth_noise=0.03, baseline=0.0)
    start = sim3_matrix(1.04 * s, R, t)
    result = optimize_sim3(*sim3_decompose(start), *pairs.arguments())
    assert result.success
    assert result.s == pytest.approx(s, rel=0.015)


def test_refinement_can_fix_the_scale():
    (s, R, t), pairs = problem(pixel_noise=0.5)
    result = optimize_sim3(1.01 * s, R, t, *pairs.arguments(), fixed_scale=True)
    assert result.s == pytest.approx(1.01 * s, rel=1e-12)


def test_depth_information_is_that_of_the_scatter():
    (s, R, t), pairs = problem(n=4000, depth_noise=0.02, baseline=0.0)
    S = sim3_matrix(1.3 * s, R, t)
    weight = depth_information(S, pairs.points_1, pairs.points_2)
    assert 1 / np.sqrt(weight) == pytest.approx(0.02 * np.sqrt(2), rel=0.05)
    assert depth_information(S, -pairs.points_1, pairs.points_2) == 0.0
    perfect = problem(baseline=0.0)[1]
    assert depth_information(S, perfect.points_1, perfect.points_2) == pytest.approx(1e6)


def test_a_bad_start_fails_without_an_error():
    _, pairs = problem()
    turned = np.diag([-1.0, 1.0, -1.0])
    result = optimize_sim3(1.0, turned, np.zeros(3), *pairs.arguments())
    assert not result.success
    assert np.isfinite(result.R).all() and np.isfinite(result.t).all()


def test_kernels_compile_once():
    _, pairs = problem(pixel_noise=0.5)
    for cast in (np.asfortranarray, lambda a: a.astype(np.float32)):
        other = Pairs(*(cast(a) for a in astuple(pairs)))
        result = ransac_sim3(*other.arguments(), np.random.default_rng(0))
        optimize_sim3(result.s, np.asfortranarray(result.R), result.t, *other.arguments())
        horn_sim3(other.points_1, other.points_2)
    for kernel in (kernels.ransac, kernels.refine, kernels.agreeing):
        assert len(kernel.signatures) == 1
