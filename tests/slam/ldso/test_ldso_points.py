"""Points without depth: looks along their rays against exact depths and a slow twin; activation."""

import numpy as np
import pytest
from ldso_scenes import CONFIG, INTRINSICS, POSES, RECTIFIER, depth_of, motion, selected, view, window_of

from dslab.slam.direct._alignment_kernels import PATTERN
from dslab.slam.direct.rays import POSE_PX
from dslab.slam.ldso._activation_kernels import apart, refine_depths
from dslab.slam.ldso.points import Immature

HUBER = CONFIG.photometric.huber


def searched(*twists, affine=(0.0, 0.0), noise=1.0, shift=None):
    """Points of the first view after looks from others, and their exact inverse depths.

    ``shift`` moves the poses that the search believes, as a twist.
    """
    image, depth = view(np.eye(4))
    points = selected(RECTIFIER.pyramid(image), 0)
    rng = np.random.default_rng(2)
    for twist in twists:
        seen, _ = view(motion(twist), np.exp(affine[0]), affine[1])
        seen = np.clip(seen + rng.normal(0, noise, seen.shape), 0, 255).astype(np.uint8)
        T = motion(twist) if shift is None else motion(shift) @ motion(twist)
        points.search(
            RECTIFIER.pyramid(seen), INTRINSICS[0], T[None], np.array([affine]), noise, CONFIG.photometric
        )
    xy = points.uv.astype(int)
    return points, 1 / depth[xy[:, 1], xy[:, 0]]


STEPS = [[0.03 * k, 0.01 * k, 0.0, 0.0, -0.005 * k, 0.0] for k in (1, 2, 4, 6)]


@pytest.mark.parametrize("noise", [1.0, 4.0])
def test_stated_deviations_are_those_of_the_depths(noise):
    points, exact = searched(*STEPS, noise=noise)
    ripe = points.is_ripe
    assert ripe.mean() > 0.6
    error = np.abs(points.inverse_depth - exact) / np.sqrt(points.variance)
    assert (error[ripe] < 1.96).mean() > 0.9
    assert np.median(np.abs(points.inverse_depth / exact - 1)[ripe]) < 0.01
    informed = points.variance < points.prior / 4
    assert (error[informed] < 4).mean() > 0.95


def test_errors_of_the_poses_do_not_average_out():
    """Twenty looks from one place, off by a fifth of a pixel, leave what one of them leaves."""
    there = STEPS[-1]
    across = np.array([0.0, 0.0, 0.0, POSE_PX / 250, POSE_PX / 250, 0.0])
    many, exact = searched(*[there] * 20, shift=across)
    one, _ = searched(there, shift=across)
    ripe = many.is_ripe & one.is_ripe
    error = np.abs(many.inverse_depth - exact)[ripe] / np.sqrt(many.variance[ripe])
    assert (error < 1.96).mean() > 0.9
    assert np.median(many.variance[ripe] / one.variance[ripe]) > 0.8


def test_brightness_is_taken_out_of_the_search():
    points, exact = searched([0.05, 0, 0, 0, 0, 0], affine=(-0.3, 20.0))
    good = points.right == 1
    assert good.mean() > 0.7 and np.median(np.abs(points.inverse_depth / exact - 1)[good]) < 0.03


def test_near_points_are_found_after_a_long_step_too():
    points, exact = searched([0.25, 0, 0, 0, 0, 0])
    far = exact * 0.25 * INTRINSICS[0, 0] > 25
    good = far & (points.right == 1)
    assert far.sum() > 50 and good.sum() > 0.6 * far.sum()
    assert np.median(np.abs(points.inverse_depth / exact - 1)[good]) < 0.02


def test_turning_alone_tells_no_depth():
    points, _ = searched([0, 0, 0, 0.01, 0.02, 0], [0, 0, 0, -0.01, 0.03, 0.02])
    assert not points.is_ripe.any()
    np.testing.assert_array_equal(points.variance, points.prior)


def test_repeated_patterns_say_nothing():
    """Where the line shows the same several times, no place is taken."""
    y, x = np.mgrid[:240, :320]
    image = (120 + 60 * np.sin(2 * np.pi * x / 6) * np.sin(2 * np.pi * y / 31)).astype(np.uint8)
    pyramid = RECTIFIER.pyramid(image)
    points = selected(pyramid, 0)
    points.search(
        pyramid, INTRINSICS[0], motion([0.1, 0, 0, 0, 0, 0])[None], np.zeros((1, 2)), 1.0, CONFIG.photometric
    )
    seen = ~points.outside
    assert seen.sum() > 100 and (points.right[seen] == 0).mean() > 0.95


def test_a_covered_surface_is_counted_as_wrong_and_given_up():
    image, _ = view(np.eye(4))
    points = selected(RECTIFIER.pyramid(image), 0)
    other = RECTIFIER.pyramid(np.random.default_rng(1).integers(0, 255, image.shape).astype(np.uint8))
    for twist in STEPS:
        points.search(other, INTRINSICS[0], motion(twist)[None], np.zeros((1, 2)), 3.0, CONFIG.photometric)
    seen = ~points.outside
    assert points.is_hopeless[seen].mean() > 0.9 and not points.is_ripe.any()


def test_the_place_found_is_the_best_of_a_slow_search():
    T = motion([0.06, 0.02, 0.01, 0.01, 0.0, 0.02])
    points, _ = searched([0.06, 0.02, 0.01, 0.01, 0.0, 0.02], noise=0.0)
    level = RECTIFIER.pyramid(view(T)[0]).levels[0][..., 0]
    fx, fy, cx, cy = INTRINSICS[0]
    turned = PATTERN @ T[:2, :2].T

    def project(ray, d):
        X = T[:3, :3] @ ray + T[:3, 3] * d
        return X[:2] / X[2] * [fx, fy] + [cx, cy]

    close = []
    inner = ((points.uv > 40) & (points.uv < [280, 200])).all(axis=1)
    rows = np.flatnonzero(inner & (points.right == 1) & (points.variance < 0.01 * points.prior))[:60]
    for i in rows:
        ray = np.array([*((points.uv[i] - [cx, cy]) / [fx, fy]), 1.0])
        start = project(ray, 0.0)
        along = project(ray, 0.01) - start
        along /= np.linalg.norm(along)
        places = np.arange(0.0, 0.027 * 560 + 1, 0.1)
        costs = []
        for s in places:
            at = start + s * along + turned
            low = np.floor(at).astype(int)
            p = at - low
            corner = level[low[:, 1, None, None] + [[0], [1]], low[:, 0, None, None] + [[0, 1]]]
            value = np.einsum("kyx,ky,kx->k", corner, *(np.stack([1 - q, q], 1) for q in (p[:, 1], p[:, 0])))
            r = np.abs(value - points.intensity[i])
            costs.append((points.weight[i] * np.where(r < HUBER, r**2, HUBER * (2 * r - HUBER))).sum())
        best = start + places[int(np.argmin(costs))] * along
        close.append(np.linalg.norm(project(ray, points.inverse_depth[i]) - best))
    assert np.quantile(close, 0.9) < 0.25 and len(close) == 60


def test_no_points_can_be_searched_and_joined():
    none = Immature.none()
    assert len(none) == 0 and len(none.with_more(none)) == 0 and not none.is_ripe.any()


def test_depths_are_refined_to_the_exact_ones():
    window = window_of()
    p = window.active
    exact = p.inverse_depth.copy()
    found = exact * np.random.default_rng(1).uniform(0.93, 1.07, len(exact))
    information, seen = np.empty(len(p)), np.empty((len(p), window.size), np.int8)
    refine_depths(
        window.images, window.live, INTRINSICS[0], PATTERN, p.uv, p.host, p.intensity, p.weight,
        window.motions(), window.brightness(), HUBER, window.outlier, found, information, seen,
    )  # fmt: skip
    alike = (seen == 1).sum(axis=1) >= 2
    assert alike.mean() > 0.5
    assert np.median(np.abs(found / exact - 1)[alike]) < 0.004
    assert (seen[:, ~window.live] == -1).all()


def test_points_are_apart_from_others_and_from_each_other():
    rng = np.random.default_rng(4)
    there, at = rng.uniform(0, 100, (30, 2)), rng.uniform(0, 100, (150, 2))
    distance = rng.choice([4, 8, 16], 150)
    taken, kept = np.zeros((100, 100), bool), np.zeros(150, bool)
    taken[there[:, 1].astype(int), there[:, 0].astype(int)] = True
    apart(at, distance, taken, kept)
    before = [tuple(p) for p in there.astype(int)]
    for (x, y), d, is_kept in zip(at.astype(int), distance, kept, strict=True):
        assert is_kept == all(max(abs(x - u), abs(y - v)) > d for u, v in before)
        if is_kept:
            before.append((x, y))
    assert 10 < kept.sum() < 100


def test_the_scene_has_the_depth_that_it_says():
    depth, at = depth_of(POSES[1])
    y, x = 100, 200
    ray = np.array([(x - 159.5) / 250, (y - 119.5) / 250, 1.0])
    point = np.linalg.inv(POSES[1]) @ np.append(ray * depth[y, x], 1.0)
    np.testing.assert_allclose(point[:2], at[y, x], atol=1e-9)
    np.testing.assert_allclose(
        point[2], 2 + 0.25 * np.sin(2 * point[0]) + 0.2 * np.cos(1.5 * point[1]) + 0.2 * point[0], atol=1e-6
    )
