"""Two-view reconstruction as ORB-SLAM publishes it: two models by RANSAC, one chosen, a clear winner or none.

Source: Mur-Artal, Montiel, Tardós, "ORB-SLAM", 2015, section IV. Where the text gives no number it is derived
here, or one by which descriptions of the release know it; each says so.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dslab.slam.initialization import _two_view_models as models
from dslab.slam.initialization.two_view import TwoViewResult, failed

_ITERATIONS = 200  # "prefixed and the same for both models": release
_SAMPLE, _SAMPLE_H = 8, 4  # matches of a sample: section IV-2
_HOMOGRAPHY_SHARE = 0.45  # equation (4)
_SIGMA_PX = 1.0  # "standard deviation of 1 pixel in the measurement error": section IV-2
_POINTS, _PARALLAX_DEG = 50, 1.0  # fewest points, and the parallax that as many must have: release
_GOOD_SHARE = 0.9  # share of the inliers that the winner must triangulate: release
_ERROR_SIGMAS = np.sqrt(5.99)  # "low reprojection error": T_H of section IV-2, 95 % in two dimensions
_CLEAR_SIGMAS = (
    3.0  # "clear winner": two counts n and m differ by chance by sqrt(n + m), so by three of these
)
_FAR_SIGMAS = 2.0  # "seen with parallax": beyond the noise of the angle, sqrt(2) px for two rays


def published_reconstruction(
    pixels_1: np.ndarray, pixels_2: np.ndarray, K: np.ndarray, rng: np.random.Generator
) -> TwoViewResult:
    """Estimate the relative pose of two views and their common points.

    Args:
        pixels_1: (N, 2) undistorted keypoints of view 1, px, on the finest level.
        pixels_2: (N, 2) the matched keypoints of view 2, px.
        K: (3, 3) camera matrix of both.
        rng: stream of the sampling.
    """
    failure = failed(len(pixels_1))
    if len(pixels_1) < _SAMPLE:
        return replace(failure, reason="too_few_matches")
    samples = np.array([rng.choice(len(pixels_1), _SAMPLE, replace=False) for _ in range(_ITERATIONS)])
    (x_1, N_1), (x_2, N_2) = _normalized(pixels_1), _normalized(pixels_2)
    homographies = np.linalg.inv(N_2) @ _homographies(x_1, x_2, samples[:, :_SAMPLE_H]) @ N_1
    fundamentals = N_2.T @ _fundamentals(x_1, x_2, samples) @ N_1
    score_h, inliers_h, H = _best(models.homography_score, homographies, pixels_1, pixels_2)
    score_f, inliers_f, F = _best(models.epipolar_score, fundamentals, pixels_1, pixels_2)
    failure = replace(failure, score_h=score_h, score_e=score_f)
    if score_h + score_f <= 0:
        return replace(failure, reason="no_model")
    if score_h / (score_h + score_f) > _HOMOGRAPHY_SHARE:
        motions = models.homography_motions(H, K)
        return _winner(motions, pixels_1, pixels_2, inliers_h, K, replace(failure, model="homography"))
    motions = models.essential_motions(K.T @ F @ K)
    return _winner(motions, pixels_1, pixels_2, inliers_f, K, replace(failure, model="essential"))


def _winner(
    motions: list[np.ndarray],
    pixels_1: np.ndarray,
    pixels_2: np.ndarray,
    inliers: np.ndarray,
    K: np.ndarray,
    failure: TwoViewResult,
) -> TwoViewResult:
    """The motion that puts clearly most points in front of both cameras, with parallax; section IV-4."""
    error_px = np.full(len(pixels_1), _ERROR_SIGMAS * _SIGMA_PX)
    far_deg = float(np.rad2deg(_FAR_SIGMAS * np.sqrt(2.0) * _SIGMA_PX / K[0, 0]))
    tried = [models.try_motion(T, pixels_1, pixels_2, inliers, K, error_px, far_deg) for T in motions]
    tried.sort(key=lambda t: int((t.triangulated | t.far).sum()), reverse=True)
    if not tried:  # the camera only rotated
        return replace(failure, reason="low_parallax")
    best, *others = tried
    good = int((best.triangulated | best.far).sum())
    parallax = np.sort(best.parallax_deg[best.triangulated | best.far])
    parallax_deg = float(parallax[-min(_POINTS, len(parallax))]) if len(parallax) else 0.0
    failure = replace(failure, parallax_deg=parallax_deg)
    if good < max(_POINTS, _GOOD_SHARE * inliers.sum()) or best.triangulated.sum() < _POINTS:
        return replace(failure, reason="few_points")
    counts = [int((t.triangulated | t.far).sum()) for t in others]
    if any(good - n < _CLEAR_SIGMAS * np.sqrt(good + n) for n in counts):
        return replace(failure, reason="ambiguous")
    if parallax_deg < _PARALLAX_DEG:
        return replace(failure, reason="low_parallax")
    return replace(
        failure, success=True, T_2_1=best.T_2_1, points=best.points, triangulated=best.triangulated
    )


def _best(
    score: Callable[..., tuple[float, np.ndarray]],
    found: np.ndarray,
    pixels_1: np.ndarray,
    pixels_2: np.ndarray,
) -> tuple[float, np.ndarray, np.ndarray]:
    """Score, inliers (N,) bool and matrix of the best of some models (M, 3, 3)."""
    scored = [score(matrix, pixels_1, pixels_2, _SIGMA_PX) for matrix in found]
    best = max(range(len(found)), key=lambda i: scored[i][0])
    return *scored[best], found[best]


def _normalized(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) about their mean, at a mean distance of √2, and the (3, 3) map that makes them so.

    Source: Hartley, Zisserman, "Multiple View Geometry", 2004, section 4.4.4.
    """
    mean = pixels.mean(axis=0)
    scale = np.sqrt(2.0) / max(np.linalg.norm(pixels - mean, axis=1).mean(), np.finfo(float).tiny)
    N = np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1.0]])
    return np.column_stack([pixels, np.ones(len(pixels))]) @ N.T, N


def _homographies(x_1: np.ndarray, x_2: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """(M, 3, 3) homographies x_2 ~ H x_1 of samples (M, 4), by the DLT: the same, algorithm 4.2."""
    a, b = x_1[samples], x_2[samples]
    zero = np.zeros_like(a)
    upper = np.concatenate([zero, -b[..., 2:] * a, b[..., 1:2] * a], axis=-1)
    lower = np.concatenate([b[..., 2:] * a, zero, -b[..., :1] * a], axis=-1)
    return _null_vectors(np.concatenate([upper, lower], axis=1))


def _fundamentals(x_1: np.ndarray, x_2: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """(M, 3, 3) fundamental matrices x_2ᵀ F x_1 = 0 of samples (M, 8): the same, algorithm 11.1."""
    a, b = x_1[samples], x_2[samples]
    U, s, Vt = np.linalg.svd(_null_vectors((b[..., :, None] * a[..., None, :]).reshape(len(a), -1, 9)))
    s[:, 2] = 0.0
    return (U * s[:, None]) @ Vt


def _null_vectors(A: np.ndarray) -> np.ndarray:
    """(M, 3, 3) matrices whose entries A (M, n, 9) takes nearest to zero."""
    return np.linalg.svd(A)[2][:, -1].reshape(-1, 3, 3)
