"""Window: derivatives, elimination against a dense solve, known answers, marginalisation."""

import numpy as np
import pytest
from ldso_scenes import CAMERA, CONFIG, POSES, motion, smooth_level, window_of

from dslab.slam.direct._alignment_kernels import PATTERN
from dslab.slam.ldso.adjustment import adjust, gauge
from dslab.slam.ldso.marginalisation import leaving, remove_keyframe, remove_points, without
from dslab.slam.ldso.model import model_of
from dslab.slam.ldso.points import Active
from dslab.slam.ldso.window import bound_of

PHOTOMETRIC = CONFIG.photometric


def moved_by(window, step, depths):
    window.move_to(step.reshape(window.size, 8))
    window.active.inverse_depth = depths


def smooth_window():
    """Window whose images are exact for interpolation, in which residuals are large."""
    window = window_of(POSES[:3], 60)
    window.images[window.slots] = smooth_level()
    window.outlier[:] = 1e12
    p = window.active
    at = p.uv.astype(int)
    p.weight[:] = np.random.default_rng(5).uniform(0.5, 1.0, p.weight.shape)
    own = smooth_level()[at[:, 1], at[:, 0], 0]
    p.intensity = own[:, None] + np.random.default_rng(6).normal(0, 8, p.intensity.shape)
    for slot in window.slots:
        window.affine_first[slot] = window.affine[slot] = [0.05 * slot, 2.0 * slot]
    return window


def test_the_model_is_the_derivative_of_the_cost(monkeypatch):
    """The pattern moves as one in the Jacobians, so that a pattern of equal pixels makes them exact."""
    monkeypatch.setattr("dslab.slam.ldso.model.PATTERN", np.zeros((8, 2)))
    window = smooth_window()
    taken = window.active.seen >= 0
    depths = window.active.inverse_depth.copy()
    model = model_of(window, window.active, taken, PHOTOMETRIC.huber)

    def cost(step, inverse_depth):
        moved_by(window, step, inverse_depth)
        return model_of(window, window.active, taken, PHOTOMETRIC.huber).cost

    h, zero = 1e-6, np.zeros(8 * window.size)
    for k in (8 * s + k for s in window.slots for k in range(8)):
        e = np.zeros_like(zero)
        e[k] = h
        numeric = (cost(e, depths) - cost(-e, depths)) / (4 * h)
        assert numeric == pytest.approx(model.b[k], rel=2e-4, abs=2e-4 * np.abs(model.b).max())
    for i in range(0, len(depths), 7):
        e = np.zeros_like(depths)
        e[i] = h
        numeric = (cost(zero, depths + e) - cost(zero, depths - e)) / (4 * h)
        assert numeric == pytest.approx(model.gradient[i], rel=2e-4, abs=1.0)


def test_costs_equal_their_twin():
    window = window_of(points=60)
    window.affine[window.slots[1]] = [0.1, -4.0]
    window.outlier[:] = 8 * 6.0**2
    p, (fx, fy, cx, cy) = window.active, window.intrinsics[0]
    model = model_of(window, p, p.seen >= 0, PHOTOMETRIC.huber)
    states = []
    for i, s in np.argwhere(p.seen >= 0):
        h = p.host[i]
        T = window.T_cam_map[s] @ np.linalg.inv(window.T_cam_map[h])
        gain = np.exp(window.affine[s, 0] - window.affine[h, 0])
        rays = np.column_stack([(p.uv[i] + PATTERN - [cx, cy]) / [fx, fy], np.ones(8)])
        X = rays @ T[:3, :3].T + T[:3, 3] * p.inverse_depth[i]
        at = X[:, :2] / X[:, 2:] * [fx, fy] + [cx, cy]
        size = np.array(window.images.shape[2:0:-1])
        cost, state = 0.0, -1
        if ((at >= 1) & (at < size - 2)).all():
            low = np.floor(at).astype(int)
            f = at - low
            corner = window.images[s][low[:, 1, None, None] + [[0], [1]], low[:, 0, None, None] + [[0, 1]], 0]
            weights = [np.stack([1 - q, q], axis=1) for q in (f[:, 1], f[:, 0])]
            value = np.einsum("kyx,ky,kx->k", corner, *weights)
            r = np.abs(value - window.affine[s, 1] - gain * (p.intensity[i] - window.affine[h, 1]))
            k = PHOTOMETRIC.huber
            cost, state = (p.weight[i] * np.where(r <= k, r**2, k * (2 * r - k))).sum(), 1
            if cost > window.outlier[s]:
                cost, state = window.outlier[s], 0
        states.append(state)
        assert model.seen[i, s] == state and model.energy[i, s] == pytest.approx(cost, rel=1e-5, abs=1e-6)
    assert set(states) == {-1, 0, 1} and model.cost == pytest.approx(model.energy.sum())


def test_a_residual_hangs_on_no_other_point():
    """Points are worked at by eights of one host; here beside others, some unseen, not taken or alike."""
    window = window_of(POSES + [motion([0.03 * k, 0.0, 0.02, 0.0, 0.01 * k, 0.0]) for k in range(4)], 61)
    assert len(window) == window.size  # what a full block leaves behind in the last slot meets a smaller one
    window.images[window.slots[2], :, 150:170] = np.nan
    window.outlier[:] = 8 * 6.0**2
    p, rng = window.active, np.random.default_rng(3)
    taken = (p.seen >= 0) & (rng.random(p.seen.shape) < 0.7)
    model = model_of(window, p, taken, PHOTOMETRIC.huber)
    order = rng.permutation(len(p))
    shuffled = model_of(window, p.of(order), taken[order], PHOTOMETRIC.huber)
    for name in ("energy", "seen", "information", "gradient", "cross"):
        np.testing.assert_array_equal(getattr(shuffled, name), getattr(model, name)[order])
    assert np.isfinite(model.H).all() and (model.seen[~taken] == -1).all()
    np.testing.assert_allclose(shuffled.H, model.H, rtol=1e-9, atol=1e-9 * np.abs(model.H).max())
    np.testing.assert_allclose(shuffled.b, model.b, rtol=1e-9, atol=1e-9 * np.abs(model.b).max())
    rows = [p.of(np.array([i])) for i in range(len(p))]
    alone = [model_of(window, row, taken[[i]], PHOTOMETRIC.huber) for i, row in enumerate(rows)]
    np.testing.assert_allclose(sum(m.H for m in alone), model.H, atol=1e-9 * np.abs(model.H).max())


def test_elimination_of_depths_equals_a_dense_solve():
    window = smooth_window()
    seen = model_of(window, window.active, window.active.seen >= 0, PHOTOMETRIC.huber).information > 1
    window.active = window.active.of(seen)
    model = model_of(window, window.active, window.active.seen >= 0, PHOTOMETRIC.huber)
    used = np.array([8 * s + k for s in window.slots[1:] for k in range(8)])
    n = len(window.active)
    dense = np.zeros((len(used) + n, len(used) + n))
    ridge = 1e-3 * np.diag(model.H.diagonal())
    H = model.H + ridge
    dense[: len(used), : len(used)] = H[np.ix_(used, used)]
    dense[len(used) :, : len(used)] = model.cross[:, used]
    dense[: len(used), len(used) :] = model.cross[:, used].T
    dense[len(used) :, len(used) :] = np.diag(model.information)
    expected = -np.linalg.solve(dense, np.concatenate([model.b[used], model.gradient]))
    off_H, off_b = model.eliminated()
    step = np.zeros(len(model.b))
    step[used] = -np.linalg.solve((H - off_H)[np.ix_(used, used)], (model.b - off_b)[used])
    np.testing.assert_allclose(step[used], expected[: len(used)], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(model.depth_steps(step), expected[len(used) :], rtol=1e-6, atol=1e-9)


def relative_errors(window, exact, scale):
    """Errors of the motions to the first keyframe, after the scale is taken out."""
    first = np.linalg.inv(window.T_cam_map[window.slots[0]])
    out = []
    for slot, T in zip(window.slots[1:], exact[1:], strict=True):
        found = window.T_cam_map[slot] @ first
        true = T @ np.linalg.inv(exact[0])
        out.append(
            [np.linalg.norm(found[:3, 3] * scale - true[:3, 3]), np.abs(found[:3, :3] - true[:3, :3]).max()]
        )
    return np.max(out, axis=0)


def disturbed(points=800):
    window = window_of(points=points)
    rng = np.random.default_rng(7)
    exact = window.active.inverse_depth.copy()
    delta = window.delta.copy()
    for slot in window.slots[1:]:
        delta[slot, :6] = rng.normal(0, [0.006] * 3 + [0.002] * 3)
    window.move_to(delta)
    for slot in window.slots:
        window.settle(slot)
    window.active.inverse_depth = exact * rng.uniform(0.97, 1.03, len(exact))
    return window, exact


def test_poses_and_depths_of_an_exact_scene_are_found():
    window, exact = disturbed()
    before = relative_errors(window, POSES, 1.0)
    adjusted = adjust(window, PHOTOMETRIC, 12)
    kept = (window.active.seen == 1).sum(axis=1) >= 2
    assert kept.mean() > 0.7 and adjusted.after < 0.5 * adjusted.before and adjusted.error < 2
    ratio = window.active.inverse_depth / exact
    scale = float(np.median(ratio[kept]))
    after = relative_errors(window, POSES, scale)
    assert (after < [1e-3, 4e-4]).all() and (after < 0.25 * before).all()
    assert np.median(np.abs(ratio / scale - 1)[kept]) < 2e-3


def test_a_step_moves_nothing_that_no_image_determines():
    window = window_of()
    before = model_of(window, window.active, window.active.seen >= 0, PHOTOMETRIC.huber).cost
    rigid = motion([0.3, -0.2, 0.1, 0.05, 0.1, -0.02])
    window.T_cam_map[window.slots] = window.T_cam_map[window.slots] @ rigid
    window.T_cam_map[:, :3, 3] *= 1.7
    window.active.inverse_depth = window.active.inverse_depth / 1.7
    after = model_of(window, window.active, window.active.seen >= 0, PHOTOMETRIC.huber).cost
    assert after == pytest.approx(before, rel=1e-6)
    window.T_first[:] = window.T_cam_map
    model = model_of(window, window.active, window.active.seen >= 0, PHOTOMETRIC.huber)
    off_H, _ = model.eliminated()
    pull = np.abs((model.H - off_H) @ gauge(window)).max()
    assert pull < 1e-3 * model.H.diagonal().max()


def test_the_oldest_keyframes_hold_place_and_scale_where_the_newest_is_moved():
    window, right = window_of(), window_of()
    moved = motion([0.06, 0.03, -0.05, 0.01, -0.02, 0.01])
    window.T_cam_map[window.newest] = moved @ right.T_cam_map[window.newest]
    window.T_first[:] = window.T_cam_map
    adjust(window, PHOTOMETRIC, 12)
    oldest = window.slots[0]
    np.testing.assert_allclose(window.T_cam_map[oldest], right.T_cam_map[oldest], atol=1e-3)
    kept = (window.active.seen == 1).sum(axis=1) >= 2
    ratio = window.active.inverse_depth / right.active.inverse_depth
    assert np.log(np.median(ratio[kept])) == pytest.approx(0, abs=0.02)


def test_what_is_minimised_out_leaves_the_rest_of_the_solution():
    rng = np.random.default_rng(8)
    J = rng.normal(size=(60, 12))
    H, b = J.T @ J, rng.normal(size=12)
    rows = np.array([2, 3, 7])
    rest = np.setdiff1d(np.arange(12), rows)
    reduced, g = without(H, b, rows)
    assert not reduced[rows].any() and not g[rows].any()
    found = np.linalg.solve(reduced[np.ix_(rest, rest)], g[rest])
    np.testing.assert_allclose(found, np.linalg.solve(H, b)[rest], rtol=1e-9)


def test_a_marginalised_keyframe_holds_the_others_where_they_were():
    """The prior's minimum is where all residuals together had theirs."""
    window, _ = disturbed()
    for _ in range(3):
        adjust(window, PHOTOMETRIC, 12)
    there = window.T_cam_map.copy()
    slot = window.slots[0]
    remove_points(window, [slot], PHOTOMETRIC)
    remove_keyframe(window, slot, PHOTOMETRIC)
    assert slot not in window.slots and not (window.active.host == slot).any()
    assert (
        window.prior_H.any()
        and np.linalg.eigvalsh(window.prior_H).min() > -1e-6 * np.abs(window.prior_H).max()
    )
    adjust(window, PHOTOMETRIC, 6)
    for s in window.slots:
        assert np.abs(window.T_cam_map[s] - there[s]).max() < 2e-3


def test_the_paper_says_which_keyframe_leaves():
    """One whose points are out of view, else the one of the largest distance score, the newest two never."""
    window = window_of([motion([0.03 * k, 0, 0, 0, 0, 0]) for k in range(7)], 350)
    new = motion([0.3, 0, 0, 0, 0, 0])
    (out,) = leaving(window, new)
    centres = [-window.T_cam_map[s][:3, 3] for s in window.slots]
    at = -new[:3, 3]

    def score(i):
        others = [np.linalg.norm(centres[i] - c) for k, c in enumerate(centres) if k != i]
        return np.sqrt(np.linalg.norm(centres[i] - at)) * sum(1 / d for d in others)

    assert out == window.slots[max(range(6), key=score)]
    few = next(s for s in window.slots[1:] if s != out)
    own = np.flatnonzero(window.active.host == few)
    own = own[np.argsort(np.abs(window.active.uv[own, 0] - CAMERA.cx))]
    in_view = len(own) // 25  # 4 % of all that it ever had
    window.drop_points(np.isin(np.arange(len(window.active)), own[in_view:]))
    assert leaving(window, new) == [few]
    behind = motion([0, 0, 0, 0, np.pi, 0])
    assert leaving(window, behind)[:2] == window.slots[:2]
    assert not set(leaving(window, behind)) & set(window.slots[-1:])


def test_the_bound_of_outliers_holds_most_patterns_whatever_share_is_another_surface():
    rng = np.random.default_rng(3)
    good = 4.0 * rng.chisquare(8, 1000)
    unlike = _unlike(rng, 40.0)
    for share in (0, 100, 400):
        bound = bound_of(np.concatenate([good, rng.uniform(2000, 20000, share)]), unlike, PHOTOMETRIC.huber)
        assert (good <= bound).mean() > 0.97 and bound < 600


def test_the_bound_of_outliers_is_that_of_even_odds_and_never_beyond_what_unlike_patterns_cost():
    unlike = _unlike(np.random.default_rng(3), 2.0)  # below Huber's bound: squares
    other = np.median(((unlike.intensity - np.roll(unlike.intensity, 250, axis=0)) ** 2).sum(axis=1))
    for own in (0.1 * other, 0.5 * other):
        bound = bound_of(np.full(9, own), unlike, PHOTOMETRIC.huber)
        assert own < bound < other
        assert np.log(other / own) == pytest.approx(bound * (1 / own - 1 / other))
    assert bound_of(np.full(9, 3 * other), unlike, PHOTOMETRIC.huber) == pytest.approx(other)


def _unlike(rng, contrast):
    points = Active.none(7)
    points.host, points.intensity = np.zeros(500, int), rng.normal(100, contrast, (500, 8))
    points.weight = np.ones((500, 8))
    return points
