"""Homographies and essential matrices: their scores, their motions, and what a motion triangulates."""

import numpy as np
import pytest
from two_view_scenes import K, direction_error_deg, rotation_error_deg, scene

from dslab.slam.initialization._two_view_models import (
    epipolar_score,
    essential_motions,
    homography_motions,
    homography_score,
    try_motion,
)


def test_scores_agree_with_their_definition():
    T, _, u, v, _ = scene("general", n=60)
    skew = np.cross(np.eye(3), T[:3, 3])
    F = np.linalg.inv(K).T @ -skew @ T[:3, :3] @ np.linalg.inv(K)
    H = K @ T[:3, :3] @ np.linalg.inv(K)

    def transferred(M, p):
        q = M @ [*p, 1.0]
        return q[:2] / q[2]

    def to_line(line, p):
        return (line @ [*p, 1.0]) ** 2 / (line[0] ** 2 + line[1] ** 2)

    for score_of, threshold, distances in (
        (homography_score, 5.991, lambda a, b: (
            ((transferred(H, a) - b) ** 2).sum(), ((transferred(np.linalg.inv(H), b) - a) ** 2).sum())),
        (epipolar_score, 3.841, lambda a, b: (
            to_line(F @ [*a, 1.0], b), to_line(F.T @ [*b, 1.0], a))),
    ):  # fmt: skip
        sigma = 15.0
        expected, inliers = 0.0, []
        for a, b in zip(u, v, strict=True):
            d = [value / sigma**2 for value in distances(a, b)]
            expected += sum(5.991 - value for value in d if value <= threshold)
            inliers.append(max(d) <= threshold)
        score, mask = score_of(H if score_of is homography_score else F, u, v, sigma)
        assert score == pytest.approx(expected, rel=1e-6)
        np.testing.assert_array_equal(mask, inliers)
        assert any(inliers)


def test_missing_and_singular_models_score_zero():
    _, _, u, v, _ = scene("general", n=60)
    for score, mask in (
        homography_score(None, u, v, 1.0),
        homography_score(np.ones((3, 3)), u, v, 1.0),
        epipolar_score(None, u, v, 1.0),
    ):
        assert score == 0.0 and not mask.any()


def test_the_true_motion_is_among_the_decompositions():
    T, *_ = scene("plane")
    t = T[:3, 3]
    normal = np.array([0.5, -0.3, 1.0])
    H = K @ (T[:3, :3] + np.outer(t, normal) / 4.0) @ np.linalg.inv(K)
    E = np.cross(np.eye(3), -t) @ T[:3, :3]
    for motions in (homography_motions(H, K), essential_motions(E)):
        assert len(motions) == 4
        errors = [rotation_error_deg(M, T) + direction_error_deg(M[:3, 3], t) for M in motions]
        assert min(errors) < 1e-4
        assert all(np.linalg.norm(M[:3, 3]) == pytest.approx(1.0) for M in motions)


def test_a_motion_triangulates_its_points_and_the_mirrored_one_none():
    T, points, u, v, _ = scene("general", n=80, outliers=0.0, noise=0.0)
    T[:3, 3] /= 0.4
    inliers = np.arange(80) > 9
    tried = try_motion(T, u, v, inliers, K, np.full(80, 2.0), 0.0)
    np.testing.assert_array_equal(tried.triangulated, inliers)
    np.testing.assert_allclose(tried.points[inliers], points[inliers] / 0.4, rtol=1e-6)
    centre = -T[:3, :3].T @ T[:3, 3]
    rays = points / 0.4, points / 0.4 - centre
    cosine = (
        (rays[0] * rays[1]).sum(axis=1) / np.linalg.norm(rays[0], axis=1) / np.linalg.norm(rays[1], axis=1)
    )
    np.testing.assert_allclose(tried.parallax_deg[inliers], np.degrees(np.arccos(cosine))[inliers], atol=1e-5)
    assert np.isnan(tried.points[~inliers]).all()
    mirror = T.copy()
    mirror[:3, 3] *= -1
    assert not try_motion(mirror, u, v, inliers, K, np.full(80, 2.0), 0.0).triangulated.any()
    far = try_motion(T, u, v, inliers, K, np.full(80, 2.0), 90.0)
    np.testing.assert_array_equal(far.far, inliers)
    assert not far.triangulated.any()
