"""Points without depth: their search against exact depths and a slow twin; activation."""

import numpy as np
from ldso_scenes import CONFIG, INTRINSICS, POSES, RECTIFIER, depth_of, motion, selected, view, window_of

from dslab.slam.direct._alignment_kernels import PATTERN
from dslab.slam.ldso._activation_kernels import refine_depths, spread
from dslab.slam.ldso._epipolar_kernels import ALONG_EDGE, CERTAIN, GOOD

HUBER = CONFIG.photometric.huber


def searched(*twists, affine=(0.0, 0.0)):
    """Points of the first view after a search in others, and their exact inverse depths."""
    image, depth = view(np.eye(4))
    points = selected(RECTIFIER.pyramid(image), 0)
    for twist in twists:
        seen, _ = view(motion(twist), np.exp(affine[0]), affine[1])
        points.search(
            RECTIFIER.pyramid(seen), INTRINSICS[0], motion(twist)[None], np.array([affine]), 0.5,
            CONFIG.immature, CONFIG.photometric,
        )  # fmt: skip
    xy = points.uv.astype(int)
    return points, 1 / depth[xy[:, 1], xy[:, 0]]


def test_intervals_hold_the_exact_depth():
    steps = [[0.03 * k, 0.01 * k, 0.0, 0.0, -0.005 * k, 0.0] for k in (1, 2, 4, 6)]
    points, exact = searched(*steps)
    known = np.isin(points.status, (GOOD, CERTAIN, ALONG_EDGE)) & np.isfinite(points.near)
    assert known.mean() > 0.8
    inside = (points.far <= exact) & (exact <= points.near)
    assert inside[known].mean() > 0.95
    ripe = points.is_ripe(CONFIG.immature)
    assert ripe.mean() > 0.4
    assert np.median(np.abs(points.inverse_depth / exact - 1)[ripe]) < 0.01


def test_brightness_is_taken_out_of_the_search():
    points, exact = searched([0.05, 0, 0, 0, 0, 0], affine=(-0.3, 20.0))
    good = points.status == GOOD
    assert good.mean() > 0.7 and np.median(np.abs(points.inverse_depth / exact - 1)[good]) < 0.03


def test_near_points_are_found_after_a_long_step_too():
    points, exact = searched([0.25, 0, 0, 0, 0, 0])
    far = exact * 0.25 * INTRINSICS[0, 0] > CONFIG.immature.most_share * 560 + 2
    good = points.status[far] == GOOD
    assert far.sum() > 50 and good.mean() > 0.6
    assert np.median(np.abs(points.inverse_depth / exact - 1)[far][good]) < 0.02


def test_the_place_found_is_the_best_of_a_slow_search():
    T = motion([0.06, 0.02, 0.01, 0.01, 0.0, 0.02])
    points, _ = searched([0.06, 0.02, 0.01, 0.01, 0.0, 0.02])
    level = RECTIFIER.pyramid(view(T)[0]).levels[0][..., 0]
    fx, fy, cx, cy = INTRINSICS[0]
    turned = PATTERN @ T[:2, :2].T

    def project(ray, d):
        X = T[:3, :3] @ ray + T[:3, 3] * d
        return X[:2] / X[2] * [fx, fy] + [cx, cy]

    close = []
    for i in np.flatnonzero(points.status == GOOD)[:60]:
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


def test_depths_are_refined_to_the_exact_ones():
    window = window_of()
    p = window.active
    exact = p.inverse_depth.copy()
    found = exact * np.random.default_rng(1).uniform(0.93, 1.07, len(exact))
    information, seen = np.empty(len(p)), np.empty((len(p), window.size), np.int8)
    refine_depths(
        window.images, window.live, INTRINSICS[0], PATTERN, p.uv, p.host, p.intensity, p.weight,
        window.motions(), window.brightness(), HUBER, window.outlier, 6, found, information, seen,
    )  # fmt: skip
    alike = (seen == 1).sum(axis=1) >= 2
    assert alike.mean() > 0.5
    assert np.median(np.abs(found / exact - 1)[alike]) < 0.004
    assert (seen[:, ~window.live] == -1).all()


def test_points_are_spread_as_their_twin_does():
    rng = np.random.default_rng(4)
    active, candidates = rng.uniform(-5, 105, (60, 2)), rng.uniform(0, 100, (150, 2))
    distance = rng.choice([3.0, 6.0, 12.0], 150)
    kept = np.zeros(150, bool)
    spread(active, candidates, distance, 12.0, kept)
    taken, expected = list(active), []
    for place, least in zip(candidates, distance, strict=True):
        free = all(np.linalg.norm(place - other) >= least for other in taken)
        expected.append(free)
        if free:
            taken.append(place)
    assert 10 < sum(expected) < 140
    np.testing.assert_array_equal(kept, expected)


def test_the_scene_has_the_depth_that_it_says():
    depth, at = depth_of(POSES[1])
    y, x = 100, 200
    ray = np.array([(x - 159.5) / 250, (y - 119.5) / 250, 1.0])
    point = np.linalg.inv(POSES[1]) @ np.append(ray * depth[y, x], 1.0)
    np.testing.assert_allclose(point[:2], at[y, x], atol=1e-9)
    np.testing.assert_allclose(
        point[2], 2 + 0.25 * np.sin(2 * point[0]) + 0.2 * np.cos(1.5 * point[1]) + 0.2 * point[0], atol=1e-6
    )
