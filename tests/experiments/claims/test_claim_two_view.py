"""The bound of two views, plain RANSAC, and pairs of rendered frames."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dslab.experiments.claims import two_view
from dslab.experiments.claims.loading import claim_presets, load_claim
from dslab.experiments.claims.plain_ransac import InlierCount, five_point, plain_ransac
from dslab.experiments.claims.two_view_bound import (
    Rays,
    median_error_deg,
    pose_covariance,
    refined,
    tangent_plane,
)
from dslab.experiments.eq1.conditioning import angle_deg

R_TRUE = Rotation.from_rotvec([0.05, -0.08, 0.03]).as_matrix()
T_TRUE = np.array([0.4, 0.05, -0.1])
E_TRUE = two_view._cross_matrix(T_TRUE) @ R_TRUE


def rays_of(n, rng, noise_px=0.0, wrong=0):
    """Matches of points 2 to 6 m away at 250 px of focal length, with octaves, noise and wrong matches."""
    X = rng.uniform([-2, -1.5, 2], [2, 1.5, 6], (n, 3))
    scales = 1.2 ** rng.integers(0, 4, (2, n, 1)) / 250 * np.ones((1, 1, 2))
    views = [X / X[:, 2:], (Y := X @ R_TRUE.T + T_TRUE) / Y[:, 2:]]
    for view, scale in zip(views, scales, strict=True):
        view[:, :2] += noise_px * scale * rng.standard_normal((n, 2))
    views[1][:wrong, :2] = rng.uniform(-0.6, 0.6, (wrong, 2))
    return Rays(*views, *scales), X


def test_the_bound_is_the_schur_complement_of_the_whole_information():
    rays, X = rays_of(12, np.random.default_rng(0))
    tangent = tangent_plane(T_TRUE / np.linalg.norm(T_TRUE))

    def measured(p):
        t = T_TRUE / np.linalg.norm(T_TRUE) + tangent @ p[3:5]
        points = X / np.linalg.norm(T_TRUE) + p[5:].reshape(-1, 3)
        Y = points @ (Rotation.from_rotvec(p[:3]).as_matrix() @ R_TRUE).T + t / np.linalg.norm(t)
        views = [v[:, :2] / v[:, 2:] / s for v, s in ((points, rays.spread1), (Y, rays.spread2))]
        return np.concatenate(views).ravel()

    steps = 1e-6 * np.eye(5 + X.size)
    J = np.array([(measured(step) - measured(-step)) / 2e-6 for step in steps]).T
    whole = np.linalg.inv(J.T @ J)
    rotation, direction = pose_covariance(R_TRUE, T_TRUE, rays)
    assert np.allclose(rotation, whole[:3, :3], rtol=1e-4)
    assert np.allclose(direction, whole[3:5, 3:5], rtol=1e-4)


@pytest.mark.slow
def test_the_most_likely_pose_reaches_the_bound():
    rng, noise_px, errors = np.random.default_rng(1), 0.5, []
    exact, _ = rays_of(60, rng)
    tangent = tangent_plane(T_TRUE / np.linalg.norm(T_TRUE))
    for _ in range(400):
        x1, x2 = exact.x1.copy(), exact.x2.copy()
        x1[:, :2] += noise_px * exact.spread1 * rng.standard_normal((60, 2))
        x2[:, :2] += noise_px * exact.spread2 * rng.standard_normal((60, 2))
        R, t = refined(R_TRUE, T_TRUE, Rays(x1, x2, exact.spread1, exact.spread2))
        errors.append([*Rotation.from_matrix(R @ R_TRUE.T).as_rotvec(), *(t @ tangent)])
    errors = np.array(errors)
    bounds = pose_covariance(R_TRUE, T_TRUE, exact)
    for own, bound in zip((errors[:, :3], errors[:, 3:]), bounds, strict=True):
        spread, least = np.sqrt((own**2).sum(axis=1).mean()), noise_px * np.sqrt(np.trace(bound))
        assert spread == pytest.approx(least, rel=0.1)
        median_deg = np.rad2deg(np.median(np.linalg.norm(own, axis=1)))
        assert median_deg == pytest.approx(median_error_deg(noise_px**2 * bound), rel=0.1)


def test_five_matches_have_the_solutions_that_opencv_finds_and_the_true_one():
    rays, _ = rays_of(50, np.random.default_rng(2))
    found, sample = five_point(rays.x1.reshape(-1, 5, 3), rays.x2.reshape(-1, 5, 3))

    def distance(E, of):
        E = E / np.linalg.norm(E)
        return min(np.abs(sign * E - own).max() for own in found[sample == of] for sign in (1, -1))

    for number in range(10):
        at = slice(5 * number, 5 * number + 5)
        theirs = cv2.findEssentialMat(rays.x1[at, :2].copy(), rays.x2[at, :2].copy(), np.eye(3))[0]
        assert len(theirs) == 3 * np.count_nonzero(sample == number)
        assert max(distance(E, number) for E in [E_TRUE, *theirs.reshape(-1, 3, 3)]) < 1e-6


def test_plain_ransac_draws_as_many_samples_as_asked(monkeypatch):
    rays, _ = rays_of(120, np.random.default_rng(3), 0.3, wrong=30)
    drawn = []
    monkeypatch.setattr(
        "dslab.experiments.claims.plain_ransac.five_point",
        lambda x1, x2: (drawn.append(len(x1)), five_point(x1, x2))[1],
    )
    found = plain_ransac(rays.x1, rays.x2, 2 / 250, (70, 700), np.random.default_rng(4))
    assert sum(drawn) == 700
    counts = [inliers.sum() for _, inliers in found]
    true = InlierCount(rays.x1, rays.x2, 2 / 250).masks(E_TRUE[None])[0]
    assert counts[0] <= counts[1] and counts[1] >= 85 and 85 <= true.sum() < 100
    few = plain_ransac(rays.x1, rays.x2, 2 / 250, (70,), np.random.default_rng(4))
    assert np.array_equal(few[0][0], found[0][0])
    assert two_view.claimed_confidence(0.5, 50) == pytest.approx(1 - (1 - 0.5**5) ** 50)


def test_the_estimate_of_wide_views_with_wrong_matches_is_near_the_bound():
    ratios = []
    for seed in range(20):
        rays, _ = rays_of(150, np.random.default_rng(seed), 0.3, wrong=30)
        _, direction, inliers = two_view.essential_pose(rays, 250, 1.0, seed)
        assert inliers[30:].sum() > 80 and inliers[:30].sum() < 10
        _, bound = pose_covariance(R_TRUE, T_TRUE, rays.of(np.arange(30, 150)))
        ratios.append(angle_deg(direction, T_TRUE) / median_error_deg(0.3**2 * bound))
    assert np.median(ratios) < 1.7


def test_the_depth_of_a_plane_is_exact_between_pixels_and_unknown_at_an_edge():
    x, y = np.meshgrid(np.arange(8.0), np.arange(6.0))
    depth = 1 / (0.2 + 0.001 * x + 0.002 * y)
    at = np.array([[2.3, 1.6], [4.0, 3.0]])
    assert np.allclose(two_view.depth_at(depth, at), 1 / (0.2 + 0.001 * at[:, 0] + 0.002 * at[:, 1]))
    depth[:, 5:] *= 2
    assert np.isnan(two_view.depth_at(depth, np.array([[4.5, 2.0]]))).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["conditioning", "ransac-iterations"])
def test_pairs_of_frames_know_their_truth_and_are_measured_alike_twice(name):
    assert name in claim_presets()
    cut = {"gaps": (2, 16), "exposed_s": 2, "starts": 1}
    spec = load_claim(name).model_copy(update=cut | ({"iterations": (50, 200)} if "ransac" in name else {}))
    rows = two_view.measure(spec, {"scene": "room", "world": 0})
    assert rows == two_view.measure(spec, {"scene": "room", "world": 0})
    narrow, wide = rows[0], rows[-1]
    assert 0 < narrow["baseline_m"] < wide["baseline_m"] and narrow["parallax_deg"] < wide["parallax_deg"]
    # Corners at whole pixels are off by about the 0.29 px of rounding.
    assert 0.15 < narrow["noise_px"] < 0.6 and narrow["right"] > 0.7 * narrow["matches"]
    assert 0 < wide["bound_direction_deg"] < narrow["bound_direction_deg"] < 90
    assert wide["direction_deg"] < 10
