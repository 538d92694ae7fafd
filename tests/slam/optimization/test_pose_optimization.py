import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares

from dslab.slam.optimization import pose as pose_module
from dslab.slam.optimization._cholesky import factor, solve
from dslab.slam.optimization._se3 import orthonormalise, retract, so3_exp
from dslab.slam.optimization.pose import CHI2_2DOF, direction_deviation, linearise, optimize_pose, refine_pose

FX, FY, CX, CY = 500.0, 510.0, 320.0, 240.0
INTRINSICS = (FX, FY, CX, CY)


def rigid(translation, rotation):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = so3_exp(*map(float, rotation)), translation
    return T


def project(T, points):
    q = points @ T[:3, :3].T + T[:3, 3]
    return q[:, :2] / q[:, 2:] * [FX, FY] + [CX, CY]


def problem(seed=0, n=120, noise=1.0, outliers=0):
    """True pose, a start near it, points, pixels, information."""
    rng = np.random.default_rng(seed)
    truth = rigid(rng.normal(0, 0.3, 3), rng.normal(0, 0.1, 3))
    points = rng.uniform([-4, -3, 4], [4, 3, 12], (n, 3))
    sigma2 = 1.2 ** (2.0 * rng.integers(0, 8, n))
    pixels = project(truth, points) + noise * rng.normal(size=(n, 2)) * np.sqrt(sigma2)[:, None]
    pixels[:outliers] += rng.choice([-1, 1], (outliers, 2)) * rng.uniform(25, 90, (outliers, 2))
    start = rigid(rng.normal(0, 0.05, 3), rng.normal(0, 0.02, 3)) @ truth
    return truth, start, points, pixels, 1.0 / sigma2


def whitened(T, points, pixels, inv_sigma2):
    return (project(T, points) - pixels) * np.sqrt(inv_sigma2)[:, None]


def huber(residuals, huber2):
    """Residual vectors whose plain squares add up to the Huber cost of ``residuals`` (N, 2)."""
    chi2 = (residuals**2).sum(axis=1)
    rho = np.where(chi2 > huber2, 2 * np.sqrt(huber2 * chi2) - huber2, chi2) if huber2 > 0 else chi2
    return residuals * np.sqrt(rho / np.maximum(chi2, 1e-300))[:, None]


def twist_matrix(twist):
    v, (x, y, z) = twist[:3], twist[3:]
    return np.array([[0, -z, y, v[0]], [z, 0, -x, v[1]], [-y, x, 0, v[2]], [0, 0, 0, 0]])


def stepped(T, twist):
    out = np.eye(4)
    retract(T, np.ascontiguousarray(twist), out)
    return out


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.02, 0.0316, 0.0317, 0.5, 3.0])
def test_a_step_is_the_matrix_exponential(size):
    rng = np.random.default_rng(1)
    T = rigid(rng.normal(size=3), rng.normal(size=3))
    direction = rng.normal(size=3)
    twist = np.concatenate([rng.normal(size=3), size * direction / np.linalg.norm(direction)])
    np.testing.assert_allclose(stepped(T, twist), expm(twist_matrix(twist)) @ T, atol=2e-14)


def test_orthonormalise_removes_rounding_and_keeps_the_translation():
    T = rigid([1.0, 2, 3], [0.3, -0.2, 0.9])
    spoilt = T.copy()
    spoilt[:3, :3] += 1e-7 * np.random.default_rng(0).normal(size=(3, 3))
    orthonormalise(spoilt)
    np.testing.assert_allclose(spoilt[:3, :3].T @ spoilt[:3, :3], np.eye(3), atol=1e-13)
    np.testing.assert_allclose(spoilt, T, atol=1e-6)
    np.testing.assert_array_equal(spoilt[:, 3], T[:, 3])


@pytest.mark.parametrize("n", [1, 6, 31])
def test_cholesky_solves_and_keeps_the_skyline(n):
    rng = np.random.default_rng(n)
    first = np.maximum(np.arange(n) - rng.integers(0, 5, n), 0)
    L = np.tril(rng.normal(size=(n, n))) * (np.arange(n) >= first[:, None]) + 3 * np.eye(n)
    A, b = L @ L.T, rng.normal(size=n)
    expected = np.linalg.solve(A, b)
    stored = np.tril(A)
    stored[np.arange(n) < first[:, None]] = np.nan  # outside the skyline nothing may be read
    assert factor(stored, first)
    solve(stored, first, b)
    np.testing.assert_allclose(b, expected, rtol=1e-9)


@pytest.mark.parametrize(
    "A", [np.diag([1.0, -1.0]), np.zeros((2, 2)), np.ones((2, 2)), np.diag([1.0, np.nan])]
)
def test_cholesky_refuses_what_is_not_positive_definite(A):
    assert not factor(A.copy(), np.zeros(2, np.int64))


@pytest.mark.parametrize("huber2", [0.0, CHI2_2DOF])
def test_linearisation_agrees_with_finite_differences(huber2):
    """NumPy reference: residuals by matrix algebra, derivatives by central differences, IRLS weights."""
    _, start, points, pixels, inv_sigma2 = problem(outliers=20)
    active = np.random.default_rng(0).random(len(points)) < 0.8
    H, gradient = np.empty((6, 6)), np.empty(6)
    cost = linearise(start, points, pixels, inv_sigma2, active, huber2, *INTRINSICS, H, gradient)

    def residuals(twist):
        return whitened(stepped(start, twist), points, pixels, inv_sigma2)[active]

    r = residuals(np.zeros(6))
    J = np.stack([(residuals(1e-6 * e) - residuals(-1e-6 * e)) / 2e-6 for e in np.eye(6)], axis=-1)
    chi2 = (r**2).sum(axis=1)
    w = np.where(chi2 > huber2, np.sqrt(huber2 / chi2), 1.0) if huber2 > 0 else np.ones_like(chi2)
    assert cost == pytest.approx((huber(r, huber2) ** 2).sum(), rel=1e-12)
    np.testing.assert_allclose(gradient, np.einsum("n,nij,ni->j", w, J, r), rtol=1e-5, atol=1e-3)
    expected = np.einsum("n,nij,nik->jk", w, J, J)
    np.testing.assert_allclose(np.tril(H), np.tril(expected), rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("huber2", [0.0, CHI2_2DOF])
@pytest.mark.parametrize("seed", range(3))
def test_refinement_reaches_the_cost_of_scipy(seed, huber2):
    _, start, points, pixels, inv_sigma2 = problem(seed, outliers=15)
    oracle = least_squares(
        lambda twist: huber(whitened(stepped(start, twist), points, pixels, inv_sigma2), huber2).ravel(),
        np.zeros(6), xtol=1e-14, ftol=1e-14, gtol=1e-14,
    )  # fmt: skip
    T = start.copy()
    active = np.ones(len(points), np.bool_)
    cost = refine_pose(T, points, pixels, inv_sigma2, active, huber2, *INTRINSICS)
    assert cost == pytest.approx(2 * oracle.cost, rel=1e-6)


def test_perfect_data_give_back_the_true_pose():
    truth, start, points, pixels, inv_sigma2 = problem(noise=0.0)
    pose, inlier, _ = optimize_pose(start, points, pixels, inv_sigma2, *INTRINSICS)
    np.testing.assert_allclose(pose, truth, atol=1e-8)
    assert inlier.all()


@pytest.mark.parametrize("seed", range(5))
def test_outliers_are_found_and_have_no_influence(seed):
    truth, start, points, pixels, inv_sigma2 = problem(seed, n=200, outliers=80)
    sigma = 1.0 / np.sqrt(inv_sigma2)
    pixels[:80] += np.sign(pixels[:80] - project(truth, points[:80])) * 3 * sigma[:80, None]
    pose, inlier, _ = optimize_pose(start, points, pixels, inv_sigma2, *INTRINSICS)
    assert not inlier[:80].any()
    assert inlier[80:].mean() > 0.88
    np.testing.assert_allclose(pose, truth, atol=0.05)


@pytest.mark.parametrize(("noise", "believed", "own"), [(1.0, 0.95, 0.95), (1.8, 0.6, 0.95), (6.0, 0.1, 0.3)])
def test_the_noise_of_a_smeared_image_is_taken_from_its_errors(noise, believed, own):
    """Most are inliers at up to twice the noise; outliers stay outliers, and more noise is not believed."""
    _, start, points, pixels, inv_sigma2 = problem(n=400, noise=noise, outliers=80)
    for max_noise, share in ((1.0, believed), (2.0, own)):
        _, inlier, found = optimize_pose(start, points, pixels, inv_sigma2, *INTRINSICS, max_noise)
        assert inlier[80:].mean() == pytest.approx(share, abs=0.07)
        assert inlier[:80].mean() < 0.15
        assert found == pytest.approx(max(1.0, min(noise, max_noise)), rel=0.3)


def test_inliers_are_within_chi_square_at_the_returned_pose():
    _, start, points, pixels, inv_sigma2 = problem(outliers=30)
    pose, inlier, _ = optimize_pose(start, points, pixels, inv_sigma2, *INTRINSICS)
    chi2 = (whitened(pose, points, pixels, inv_sigma2) ** 2).sum(axis=1)
    np.testing.assert_array_equal(inlier, chi2 <= CHI2_2DOF)


def test_the_last_rounds_are_plain_least_squares_on_the_inliers():
    _, start, points, pixels, inv_sigma2 = problem(n=200, outliers=40)
    pose, inlier, _ = optimize_pose(start, points, pixels, inv_sigma2, *INTRINSICS)
    again = pose.copy()
    cost = refine_pose(again, points, pixels, inv_sigma2, inlier, 0.0, *INTRINSICS)
    reached = (whitened(pose, points, pixels, inv_sigma2)[inlier] ** 2).sum()
    assert reached == pytest.approx(cost, rel=1e-6)


def test_points_behind_the_camera_are_outliers_without_influence():
    truth, start, points, pixels, inv_sigma2 = problem()
    mirrored = 2 * -(truth[:3, :3].T @ truth[:3, 3]) - points[:20]
    np.testing.assert_allclose(project(truth, mirrored), project(truth, points[:20]))
    pose, inlier, _ = optimize_pose(
        start,
        np.vstack([points, mirrored]),
        np.vstack([pixels, pixels[:20]]),
        np.concatenate([inv_sigma2, inv_sigma2[:20]]),
        *INTRINSICS,
    )
    alone, inlier_alone, _ = optimize_pose(start, points, pixels, inv_sigma2, *INTRINSICS)
    assert not inlier[-20:].any()
    np.testing.assert_array_equal(inlier[:-20], inlier_alone)
    np.testing.assert_allclose(pose, alone, atol=1e-5)


def test_accurate_octaves_have_more_weight():
    """With the coarse half shifted by three pixels, the answer follows the half with the small variance."""
    _, start, points, pixels, _ = problem(noise=0.0)
    pixels[:60] += 3.0
    inv_sigma2 = np.where(np.arange(120) < 60, 1 / 36.0, 1.0)
    pose, _, _ = optimize_pose(start, points, pixels, inv_sigma2, *INTRINSICS)
    error = np.abs(project(pose, points[60:]) - pixels[60:]).max()
    assert error < 0.3


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_few_points_change_nothing(n):
    _, start, points, pixels, inv_sigma2 = problem()
    pose, inlier, _ = optimize_pose(start, points[:n], pixels[:n], inv_sigma2[:n], *INTRINSICS)
    np.testing.assert_array_equal(pose, start)
    assert inlier.shape == (n,) and not inlier.any()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_non_finite_observations_are_left_out(bad):
    _, start, points, pixels, inv_sigma2 = problem()
    expected, _, _ = optimize_pose(start, points[3:], pixels[3:], inv_sigma2[3:], *INTRINSICS)
    points[0, 1], pixels[1, 0], inv_sigma2[2] = bad, bad, bad
    pose, inlier, _ = optimize_pose(start, points, pixels, inv_sigma2, *INTRINSICS)
    assert not inlier[:3].any()
    np.testing.assert_array_equal(pose, expected)


def test_a_non_finite_pose_is_returned_unchanged():
    _, start, points, pixels, inv_sigma2 = problem()
    start[0, 3] = np.nan
    pose, inlier, _ = optimize_pose(start, points, pixels, inv_sigma2, *INTRINSICS)
    np.testing.assert_array_equal(pose, start)
    assert not inlier.any()


@pytest.mark.parametrize("case", ["same", "line", "opposite", "all behind"])
def test_degenerate_systems_stay_finite(case):
    _, start, points, pixels, inv_sigma2 = problem(n=10)
    if case == "same":
        points[:], pixels[:] = points[0], pixels[0]
    elif case == "line":
        points[:] = points[0] + np.linspace(0, 1, 10)[:, None] * [0.0, 0.0, 2.0]
    elif case == "opposite":
        pixels[:] = 2 * np.array([CX, CY]) - pixels
    else:
        points[:, 2] -= 100
    pose, _, _ = optimize_pose(start, points, pixels, inv_sigma2, *INTRINSICS)
    assert np.isfinite(pose).all()
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)


def test_input_is_unchanged_and_other_types_are_accepted():
    _, start, points, pixels, inv_sigma2 = problem()
    before = start.copy()
    expected, _, _ = optimize_pose(start, points, pixels, inv_sigma2, *INTRINSICS)
    pose, _, _ = optimize_pose(
        np.asfortranarray(start), points, pixels.astype(np.float32), inv_sigma2, *(int(v) for v in INTRINSICS)
    )
    np.testing.assert_array_equal(start, before)
    np.testing.assert_allclose(pose, expected, atol=1e-5)
    assert len(pose_module._optimize_pose.signatures) == 1


def test_pose_stays_a_rotation_over_a_long_run():
    truth, start, points, pixels, inv_sigma2 = problem()
    pose, velocity = start, np.eye(4)
    for _ in range(300):
        new, _, _ = optimize_pose(velocity @ pose, points, pixels, inv_sigma2, *INTRINSICS)
        pose, velocity = new, new @ np.linalg.inv(pose)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(pose, truth, atol=0.1)


@pytest.mark.parametrize(("strip", "least_deg", "most_deg"), [(8.0, 0.1, 0.3), (0.4, 0.3, 3.0)])
def test_the_deviation_of_the_direction_is_that_of_repeated_estimates(strip, least_deg, most_deg):
    """From keypoints with noise; points in a narrow strip leave the direction uncertain."""
    rng = np.random.default_rng(3)
    truth = rigid([0.2, -0.1, 0.3], [0.1, -0.05, 0.02])
    points = rng.uniform([0, -2, 5], [strip, 2, 7], (80, 3))
    sigma2 = 1.2 ** (2.0 * rng.integers(0, 8, 80))
    turns = []
    for _ in range(200):
        pixels = project(truth, points) + rng.normal(size=(80, 2)) * np.sqrt(sigma2)[:, None]
        T, active = truth.copy(), np.ones(80, np.bool_)
        refine_pose(T, points, pixels, 1 / sigma2, active, 0.0, *INTRINSICS)
        turns.append(np.arccos(np.clip((np.trace(T[:3, :3] @ truth[:3, :3].T) - 1) / 2, -1, 1)))
    deviation = direction_deviation(truth, points, 1 / sigma2, FX, FY)
    assert deviation == pytest.approx(np.sqrt(np.mean(np.square(turns))), rel=0.15)
    assert least_deg < np.rad2deg(deviation) < most_deg


def test_two_points_leave_the_direction_open():
    points = np.array([[0.0, 0, 5], [1.0, 0, 5]])
    assert direction_deviation(np.eye(4), points, np.ones(2), FX, FY) == np.inf
    assert direction_deviation(np.eye(4), points[:0], np.ones(0), FX, FY) == np.inf
