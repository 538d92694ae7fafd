from dataclasses import replace

import numpy as np
import pytest
from bundle_scenes import DELTA, INTRINSICS, huber, moved, n_parameters, rigid, scene
from scipy.optimize import least_squares

from dslab.slam.optimization import _ba_kernels, _schur
from dslab.slam.optimization.bundle_adjustment import bundle_adjust, local_bundle_adjust
from dslab.slam.optimization.pose import CHI2_2DOF


def test_perfect_data_are_unchanged():
    truth, _ = scene(noise=0.0)
    result = bundle_adjust(*truth.arguments(), 5, DELTA)
    np.testing.assert_allclose(result.T_cam_map, truth.T, atol=1e-10)
    np.testing.assert_allclose(result.points, truth.points, atol=1e-9)
    assert result.cost_final < 1e-15


@pytest.mark.parametrize("delta", [0.0, DELTA])
def test_perfect_data_give_back_the_truth(delta):
    truth, start = scene(noise=0.0)
    result = bundle_adjust(*start.arguments(), 30, delta)
    np.testing.assert_allclose(result.T_cam_map, truth.T, atol=1e-6)
    np.testing.assert_allclose(result.points, truth.points, atol=1e-5)
    np.testing.assert_array_equal(result.T_cam_map[:2], start.T[:2])


def test_with_one_camera_fixed_the_shape_is_found_up_to_scale():
    truth, start = scene(noise=0.0, n_fixed=1)
    result = bundle_adjust(*start.arguments(), 50, 0.0)
    scale = np.linalg.norm(result.T_cam_map[-1, :3, 3]) / np.linalg.norm(truth.T[-1, :3, 3])
    origin = np.linalg.inv(truth.T[0])[:3, 3]
    assert 0.8 < scale < 1.25
    np.testing.assert_allclose(result.points - origin, scale * (truth.points - origin), atol=1e-4)


@pytest.mark.parametrize(("seed", "delta"), [(1, 0.0), (1, DELTA), (2, DELTA)])
def test_cost_agrees_with_scipy(seed, delta):
    _, start = scene(seed, cameras=4, n_points=12, spread=0.01)
    start.pixels[::9] += 6.0
    oracle = least_squares(
        lambda step: huber(start.whitened(*moved(start, step)), delta).ravel(),
        np.zeros(n_parameters(start)), xtol=1e-13, ftol=1e-13, gtol=1e-13,
    )  # fmt: skip
    result = bundle_adjust(*start.arguments(), 400, delta)
    assert result.cost_final == pytest.approx(2 * oracle.cost, rel=1e-6)
    chi2 = (start.whitened(result.T_cam_map, result.points) ** 2).sum(axis=1)
    np.testing.assert_allclose(result.chi2, chi2, rtol=1e-6)
    assert result.cost_final == pytest.approx((huber(np.sqrt(chi2)[:, None], delta) ** 2).sum(), rel=1e-9)


@pytest.mark.parametrize("delta", [0.0, DELTA])
def test_a_step_through_the_schur_complement_is_the_dense_step(delta):
    """NumPy reference: Jacobian by central differences, the whole damped system solved at once."""
    _, start = scene(cameras=4, n_points=12)
    start.pixels[::7] += 15.0
    damping = 1e-3
    n_free, n_points, m = 2, 12, len(start.camera)
    first, order = _ba_kernels.sort_by_point(n_points, start.point)
    camera, pixels, weights = start.camera[order], start.pixels[order], start.inv_sigma2[order]
    slot, intrinsics = np.array([-1, -1, 0, 1]), np.array(INTRINSICS)
    U, V, W = np.empty((n_free, 6, 6)), np.empty((n_points, 3, 3)), np.empty((m, 6, 3))
    gradient_c, gradient_p = np.empty((n_free, 6)), np.empty((n_points, 3))
    _ba_kernels.normal_equations(
        start.T, start.points, first, camera, pixels, weights, intrinsics, delta**2, slot,
        U, V, W, gradient_c, gradient_p,
    )  # fmt: skip
    V_inv, held, S, b = np.empty_like(V), np.zeros(n_points, np.bool_), np.empty((12, 12)), np.empty(12)
    skyline = _schur.skyline(first, camera, slot, n_free)
    _schur.eliminate_points(
        U, V, W, gradient_c, gradient_p, first, camera, slot, damping, skyline, V_inv, held, S, b
    )
    step_c = np.linalg.solve(np.tril(S) + np.tril(S, -1).T, b)
    step_p = np.empty((n_points, 3))
    _schur.back_substitute(W, gradient_p, first, camera, slot, V_inv, held, step_c, step_p)
    gain = _schur.predicted_gain(U, V, gradient_c, gradient_p, damping, step_c, step_p, held)

    n = n_parameters(start)
    r = start.whitened(start.T, start.points)
    J = np.stack(
        [
            (start.whitened(*moved(start, 1e-6 * e)) - start.whitened(*moved(start, -1e-6 * e))) / 2e-6
            for e in np.eye(n)
        ],
        axis=-1,
    )
    chi2 = (r**2).sum(axis=1)
    w = np.where(chi2 > delta**2, delta / np.sqrt(chi2), 1.0) if delta > 0 else np.ones(m)
    H, g = np.einsum("m,mij,mik->jk", w, J, J), np.einsum("m,mij,mi->j", w, J, r)
    damped = H + damping * np.diag(np.diag(H))
    step = np.linalg.solve(damped, -g)
    np.testing.assert_allclose(np.concatenate([step_c, step_p.ravel()]), step, rtol=1e-4, atol=1e-7)
    assert gain == pytest.approx(-2 * g @ step - step @ H @ step, rel=1e-4)


def test_a_point_far_beyond_its_depth_comes_back():
    """A step linear in the depth would take it through the camera: damping then slows all others too."""
    truth, start = scene(noise=0.0, spread=0.0)
    centre = -truth.T[0][:3, :3].T @ truth.T[0][:3, 3]
    start = replace(start, points=centre + 3.0 * (truth.points - centre))
    slot = np.full(len(truth.T), -1)
    first, order = _ba_kernels.sort_by_point(len(truth.points), start.point)
    points = start.points.copy()
    _ba_kernels.adjust(
        truth.T.copy(), points, first, start.camera[order], start.pixels[order], start.inv_sigma2[order],
        np.array(INTRINSICS), slot, 0, 5, 0.0,
    )  # fmt: skip
    np.testing.assert_allclose(points, truth.points, atol=1e-3)


def test_a_small_move_of_points_is_the_step():
    _, start = scene()
    first, order = _ba_kernels.sort_by_point(len(start.points), start.point)
    camera = start.camera[order]
    step = np.random.default_rng(3).normal(0, 1e-6, start.points.shape)
    moved_points = np.empty_like(start.points)
    _ba_kernels.move_points(start.points, step, start.T, first, camera, moved_points)
    np.testing.assert_allclose(moved_points - start.points, step, atol=1e-11)
    # Far beyond infinity and behind the camera are no places to go.
    pose = start.T[camera[first[:-1]]]
    away = 5.0 * pose[:, 2, :3] * (pose[:, 2, 3] + (pose[:, 2, :3] * start.points).sum(1))[:, None]
    for step in (away, -away):
        _ba_kernels.move_points(start.points, step, start.T, first, camera, moved_points)
        assert ((pose[:, 2, :3] * moved_points).sum(1) + pose[:, 2, 3] > 0).all()


def test_skyline_covers_exactly_the_cameras_that_share_points():
    """Cameras 0-1 and 1-3 share a point; 2 stands alone."""
    start, order = _ba_kernels.sort_by_point(3, np.array([0, 0, 1, 1, 2], np.int32))
    camera = np.array([0, 1, 3, 1, 2], np.int32)[order]
    first = _schur.skyline(start, camera, np.arange(4), 4)
    np.testing.assert_array_equal(first[::6], [0, 0, 12, 6])
    assert len(first) == 24


def test_the_order_of_observations_does_not_matter():
    _, start = scene()
    expected = bundle_adjust(*start.arguments(), 10, DELTA)
    order = np.random.default_rng(5).permutation(len(start.camera))
    shuffled = replace(
        start,
        camera=start.camera[order],
        point=start.point[order],
        pixels=start.pixels[order],
        inv_sigma2=start.inv_sigma2[order],
    )
    result = bundle_adjust(*shuffled.arguments(), 10, DELTA)
    np.testing.assert_allclose(result.points, expected.points, atol=1e-6)
    np.testing.assert_allclose(result.chi2, expected.chi2[order], rtol=1e-3, atol=1e-6)


def test_runs_repeat_to_the_bit_and_leave_their_input():
    _, start = scene()
    before = start.points.copy(), start.T.copy()
    first, second = (bundle_adjust(*start.arguments(), 10, DELTA) for _ in range(2))
    np.testing.assert_array_equal(first.points, second.points)
    np.testing.assert_array_equal(first.T_cam_map, second.T_cam_map)
    np.testing.assert_array_equal(start.points, before[0])
    np.testing.assert_array_equal(start.T, before[1])


def test_a_free_gauge_is_refused():
    _, start = scene()
    start.fixed[:] = False
    with pytest.raises(ValueError, match="gauge"):
        bundle_adjust(*start.arguments(), 5, DELTA)


@pytest.mark.parametrize("name", ["camera", "point"])
@pytest.mark.parametrize("value", [-1, 10_000])
def test_unknown_cameras_and_points_are_refused(name, value):
    _, start = scene()
    getattr(start, name)[3] = value
    with pytest.raises(ValueError, match="out of range"):
        bundle_adjust(*start.arguments(), 5, DELTA)


def test_points_with_fewer_than_two_observations_are_not_used():
    _, start = scene()
    expected = bundle_adjust(*start.arguments(), 10, DELTA)
    lonely = replace(
        start,
        points=np.vstack([start.points, [[0.5, 0.5, 5.0], [1.0, 1.0, 6.0]]]),
        camera=np.append(start.camera, np.int32(3)),
        point=np.append(start.point, np.int32(40)),
        pixels=np.vstack([start.pixels, [[10.0, 10.0]]]),
        inv_sigma2=np.append(start.inv_sigma2, 1.0),
    )
    result = bundle_adjust(*lonely.arguments(), 10, DELTA)
    np.testing.assert_array_equal(result.points[40:], lonely.points[40:])
    np.testing.assert_array_equal(result.points[:40], expected.points)
    np.testing.assert_array_equal(result.T_cam_map, expected.T_cam_map)
    assert result.chi2.shape == lonely.camera.shape and result.chi2[-1] > 1e3


def test_with_all_cameras_fixed_only_points_move():
    truth, start = scene(noise=0.0)
    start = replace(start, T=truth.T, fixed=np.ones(5, np.bool_))
    result = bundle_adjust(*start.arguments(), 30, 0.0)
    np.testing.assert_array_equal(result.T_cam_map, truth.T)
    np.testing.assert_allclose(result.points, truth.points, atol=1e-6)


def test_no_observations_change_nothing():
    _, start = scene()
    empty = replace(
        start,
        camera=start.camera[:0], point=start.point[:0], pixels=start.pixels[:0],
        inv_sigma2=start.inv_sigma2[:0],
    )  # fmt: skip
    result, keep = local_bundle_adjust(*empty.arguments())
    np.testing.assert_array_equal(result.points, start.points)
    np.testing.assert_allclose(result.T_cam_map, start.T, atol=1e-15)
    assert keep.shape == (0,)


def test_observations_behind_their_camera_are_reported_and_not_used():
    truth, start = scene(noise=0.0)
    centre = -truth.T[4, :3, :3].T @ truth.T[4, :3, 3]
    start.points[0] = truth.points[0] = centre - truth.T[4, 2, :3]
    result = bundle_adjust(*start.arguments(), 30, DELTA)
    behind = start.point == 0
    assert not result.positive_depth[behind & (start.camera == 4)].any()
    assert np.isinf(result.chi2[~result.positive_depth]).all()
    np.testing.assert_allclose(result.T_cam_map, truth.T, atol=1e-5)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("delta", [0.0, DELTA])
def test_the_cost_never_grows_even_with_gross_errors(seed, delta):
    _, start = scene(seed, spread=0.4)
    rng = np.random.default_rng(seed)
    wild = rng.random(len(start.camera)) < 0.4
    start.pixels[wild] = rng.uniform(-500, 1500, (wild.sum(), 2))
    costs = [bundle_adjust(*start.arguments(), i, delta) for i in (0, 1, 3, 10, 30)]
    for result in costs:
        assert result.cost_initial == costs[0].cost_final
        assert np.isfinite(result.points).all() and np.isfinite(result.T_cam_map).all()
    finals = [result.cost_final for result in costs]
    assert finals == sorted(finals, reverse=True)
    assert finals[-1] < finals[0]


def test_non_finite_observations_and_points_are_left_out():
    _, start = scene()
    rows = np.ones(len(start.camera), np.bool_)
    rows[[0, 1]] = False
    start_without = replace(
        start,
        camera=start.camera[rows], point=start.point[rows], pixels=start.pixels[rows],
        inv_sigma2=start.inv_sigma2[rows],
    )  # fmt: skip
    expected, _ = local_bundle_adjust(*start_without.arguments())
    start.pixels[0, 1] = np.nan
    start.inv_sigma2[1] = np.inf
    result, keep = local_bundle_adjust(*start.arguments())
    np.testing.assert_array_equal(result.points, expected.points)
    assert not keep[:2].any()
    start.points[7] = np.nan
    result, keep = local_bundle_adjust(*start.arguments())
    assert np.isfinite(np.delete(result.points, 7, axis=0)).all()
    assert not keep[start.point == 7].any() and keep.any()


def test_the_robust_stage_ends_where_it_gains_nothing_more():
    truth, start = scene(2, cameras=8, n_points=120)
    rng = np.random.default_rng(2)
    T = np.stack([rigid([-0.03 * k, 0, 0], [0, 0, 0]) for k in range(8)])  # near to each other
    pixels = truth.reprojection(T, truth.points) + rng.normal(0, 0.5, truth.pixels.shape)
    outliers = rng.random(len(pixels)) < 0.05
    pixels[outliers] += rng.normal(0, 8, (outliers.sum(), 2))
    turned = [rigid([0, 0, 0], [0, 0.005 * k * (k > 1), 0]) @ T[k] for k in range(8)]
    points = truth.points * np.exp(rng.normal(0, 0.3, (len(truth.points), 1)))
    near = replace(start, T=np.stack(turned), points=points, pixels=pixels, inv_sigma2=np.ones(len(pixels)))
    minimum, _ = local_bundle_adjust(*near.arguments(), robust_iterations=1000)
    result, _ = local_bundle_adjust(*near.arguments())
    early, _ = local_bundle_adjust(*near.arguments(), robust_iterations=5)
    # Where the outliers are taken out.
    assert result.cost_initial == pytest.approx(minimum.cost_initial, rel=1e-6)
    assert early.cost_initial > 1.003 * minimum.cost_initial


@pytest.mark.parametrize("seed", range(3))
def test_local_adjustment_drops_outliers_and_recovers(seed):
    _, start = scene(seed, n_points=80, noise=0.3)
    rng = np.random.default_rng(seed)
    bad = rng.random(len(start.camera)) < 0.08
    start.pixels[bad] += rng.choice([-1, 1], (bad.sum(), 2)) * rng.uniform(30, 80, (bad.sum(), 2))
    result, keep = local_bundle_adjust(*start.arguments())
    seen_often = np.bincount(start.point[~bad], minlength=80)[start.point] >= 3
    assert keep[bad & seen_often].mean() < 0.05
    assert keep[~bad & seen_often].mean() > 0.95
    np.testing.assert_array_equal(keep, result.chi2 <= CHI2_2DOF)
    good = replace(
        start,
        camera=start.camera[~bad], point=start.point[~bad], pixels=start.pixels[~bad],
        inv_sigma2=start.inv_sigma2[~bad],
    )  # fmt: skip
    clean = bundle_adjust(*good.arguments(), 50, 0.0).T_cam_map
    np.testing.assert_allclose(result.T_cam_map, clean, atol=0.015)
    robust = bundle_adjust(*start.arguments(), 15, DELTA)
    assert np.abs(result.T_cam_map - clean).max() < np.abs(robust.T_cam_map - clean).max()


def test_kernels_compile_once():
    _, start = scene()
    bundle_adjust(*start.arguments(), 2, DELTA)
    other = replace(
        start,
        T=np.asfortranarray(start.T), fixed=start.fixed.astype(int), camera=start.camera.astype(np.int64),
        pixels=start.pixels.astype(np.float32),
    )  # fmt: skip
    local_bundle_adjust(*other.arguments())
    for kernel in (_ba_kernels.adjust, _ba_kernels.errors, _ba_kernels.sort_by_point):
        assert len(kernel.signatures) == 1
