"""Two-view reconstruction: relative pose and first points from matches alone.

A homography (planar or distant scene) and an essential matrix (general scene) are estimated in parallel.
The motions that both allow are refined over the epipolar errors of all matches; the one that puts most
points in front of both cameras is accepted only where no other explains the matches as well, they determine
its direction, and its points are seen under enough parallax. Refining before choosing matters: over a short
baseline the two models explain the matches equally well, and neither's raw motion is near the truth.

Source: Mur-Artal, Montiel, Tardós, "ORB-SLAM", 2015, section IV.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from slam import _two_view_models as models
from slam._two_view_models import TriedMotion
from slam._two_view_refinement import refine_motion

Reason = Literal["", "too_few_matches", "no_model", "low_parallax", "few_points", "ambiguous", "ill_conditioned"]
Model = Literal["homography", "essential"]

_MAX_ERROR_SIGMAS = 2.0
_CHI2_1DOF = 3.841
_REFINE_ITERATIONS = 20
"""Largest distance between a triangulated point's reprojection and its keypoint."""

_LINE_SIGMAS = 5.0
"""Keypoints that scatter less than this about a line do not tell one geometry from another."""


@dataclass(frozen=True)
class TwoViewConfig:
    """Settings of two-view reconstruction.

    Attributes:
        sigma_px: noise of a keypoint.
        min_matches: fewer matches are not tried.
        min_points: triangulated points that a reconstruction must have.
        min_parallax_deg: angle of rays that ``min_points`` points must reach.
        far_parallax_deg: points under less are taken for too far away to triangulate.
        homography_share: share of the homography in the scores from which the scene is called flat.
        rival_angle_deg: a motion whose direction is farther from the best one's is another motion.
        max_second_share, max_rival_cost: it is a rival if it has more than this share of the best one's
            matches at less than this multiple of its cost.
        max_direction_std_deg: standard deviation of the translation's direction.
        min_consistent_share: inliers that the best motion must triangulate, of those with parallax.
        ransac_threshold_px: largest distance to the model of an inlier in RANSAC.
        ransac_iterations: cap on the samples.
        ransac_confidence: probability with which RANSAC should find the model.
    """

    sigma_px: float = 1.0
    min_matches: int = 100
    min_points: int = 50
    min_parallax_deg: float = 1.0
    far_parallax_deg: float = 0.3
    homography_share: float = 0.38
    rival_angle_deg: float = 15.0
    max_second_share: float = 0.7
    max_rival_cost: float = 2.0
    max_direction_std_deg: float = 2.5
    min_consistent_share: float = 0.9
    ransac_threshold_px: float = 1.5
    ransac_iterations: int = 2000
    ransac_confidence: float = 0.999


@dataclass(frozen=True)
class TwoViewResult:
    """Relative pose and points of two views.

    Attributes:
        success: whether the reconstruction is to be trusted; if not, pose and points are empty of meaning.
        reason: why not.
        model: the geometry that explained the matches better, None where neither was tried or found.
        T_2_1: (4, 4) camera 1 to camera 2, translation of unit length.
        points: (N, 3) in the frame of camera 1, units of the baseline; NaN where not triangulated.
        triangulated: (N,) bool.
        parallax_deg: angle of rays that ``min_points`` of the points reach.
        score_h, score_e: scores of homography and essential matrix, higher is better.
    """

    success: bool
    reason: Reason
    model: Model | None
    T_2_1: np.ndarray
    points: np.ndarray
    triangulated: np.ndarray
    parallax_deg: float
    score_h: float
    score_e: float


def two_view_reconstruction(
    pixels_1: np.ndarray,
    pixels_2: np.ndarray,
    K: np.ndarray,
    rng: np.random.Generator,
    config: TwoViewConfig | None = None,
) -> TwoViewResult:
    """Relative pose of two views and the points they share, or the reason why there are none.

    Args:
        pixels_1: (N, 2) undistorted keypoints of view 1, px.
        pixels_2: (N, 2) the keypoints of view 2 matched with them, px.
        K: (3, 3) camera matrix of both.
        rng: source of the sampling; the same state gives the same result.
        config: settings, the defaults if None.

    Raises:
        ValueError: the views have different numbers of keypoints, or not all are finite.
    """
    config = config or TwoViewConfig()
    pixels_1 = np.ascontiguousarray(pixels_1, np.float64).reshape(-1, 2)
    pixels_2 = np.ascontiguousarray(pixels_2, np.float64).reshape(-1, 2)
    if pixels_1.shape != pixels_2.shape or not np.isfinite(pixels_1.sum() + pixels_2.sum()):
        raise ValueError(f"matches are not pairs of finite pixels: {len(pixels_1)} and {len(pixels_2)} rows")
    failure = _failure(len(pixels_1))
    if len(pixels_1) < config.min_matches:
        return replace(failure, reason="too_few_matches")
    K = np.ascontiguousarray(K, np.float64)
    K_inv = np.linalg.inv(K)
    H, E = models.estimate_models(
        pixels_1, pixels_2, K, int(rng.integers(2**31)),
        config.ransac_threshold_px, config.ransac_confidence, config.ransac_iterations,
    )  # fmt: skip
    F = None if E is None else K_inv.T @ E @ K_inv
    score_h, _ = models.homography_score(H, pixels_1, pixels_2, config.sigma_px)
    score_e, _ = models.epipolar_score(F, pixels_1, pixels_2, config.sigma_px)
    failure = replace(failure, score_h=score_h, score_e=score_e)
    if score_h + score_e <= 0.0:
        return replace(failure, reason="no_model")
    flat = score_h >= config.homography_share * (score_h + score_e)
    failure = replace(failure, model="homography" if flat else "essential")
    motions = [] if H is None else models.homography_motions(H, K)
    motions += [] if E is None else models.essential_motions(E)
    tried = [_refined(T, pixels_1, pixels_2, K, config) for T in motions]
    return _judge(tried, failure, config)


@dataclass(frozen=True)
class _Hypothesis:
    """A refined motion, what it makes of the matches, and how sure they make it."""

    tried: TriedMotion
    inliers: np.ndarray
    cost: float
    direction_std_deg: float

    @property
    def support(self) -> int:
        """Matches that it accounts for, with a point or as too far away for one."""
        return int(self.tried.triangulated.sum()) + int(self.tried.far.sum())


def _refined(
    T_2_1: np.ndarray, pixels_1: np.ndarray, pixels_2: np.ndarray, K: np.ndarray, config: TwoViewConfig
) -> _Hypothesis:
    focal, centre = np.array([K[0, 0], K[1, 1]]), K[:2, 2]
    rays_1, rays_2 = (np.ascontiguousarray((pixels - centre) / focal) for pixels in (pixels_1, pixels_2))
    sigma = config.sigma_px / float(focal.mean())
    T, errors, cost, direction_std_deg = refine_motion(T_2_1, rays_1, rays_2, sigma, _REFINE_ITERATIONS)
    inliers = errors <= _CHI2_1DOF
    error_px = _MAX_ERROR_SIGMAS * config.sigma_px
    tried = models.try_motion(T, pixels_1, pixels_2, inliers, K, error_px, config.far_parallax_deg)
    return _Hypothesis(tried, inliers, cost, direction_std_deg)


def _judge(hypotheses: list[_Hypothesis], failure: TwoViewResult, config: TwoViewConfig) -> TwoViewResult:
    """Accept the best hypothesis, or give ``failure`` its reason."""
    if not hypotheses:
        # A homography without translation: the camera turned on the spot.
        return replace(failure, reason="low_parallax")
    best, *others = sorted(hypotheses, key=lambda h: (-h.support, h.cost))
    motion = best.tried
    count = int(motion.triangulated.sum())
    parallax = motion.parallax_deg[motion.triangulated if count >= config.min_points else best.inliers]
    parallax_deg = float(np.sort(parallax)[-min(config.min_points, len(parallax))]) if len(parallax) else 0.0
    # Far points agree with every motion that turns alike, and so decide nothing.
    near = int((best.inliers & ~motion.far).sum())
    reason: Reason = ""
    if parallax_deg < config.min_parallax_deg:
        reason = "low_parallax"
    elif count < config.min_points:
        reason = "few_points"
    elif count < config.min_consistent_share * near or any(_rivals(best, h, config) for h in others):
        reason = "ambiguous"
    elif best.direction_std_deg > config.max_direction_std_deg:
        reason = "ill_conditioned"
    if reason:
        return replace(failure, reason=reason, parallax_deg=parallax_deg)
    return replace(
        failure,
        success=True,
        T_2_1=motion.T_2_1,
        points=motion.points,
        triangulated=motion.triangulated,
        parallax_deg=parallax_deg,
    )


def _rivals(best: _Hypothesis, other: _Hypothesis, config: TwoViewConfig) -> bool:
    """Whether another, truly different motion explains the matches about as well as the best."""
    cosine = float(best.tried.T_2_1[:3, 3] @ other.tried.T_2_1[:3, 3])
    return (
        cosine < np.cos(np.deg2rad(config.rival_angle_deg))
        and other.support > config.max_second_share * best.support
        and other.cost < config.max_rival_cost * best.cost
    )


def _failure(n: int) -> TwoViewResult:
    return TwoViewResult(
        False, "", None, np.eye(4), np.full((n, 3), np.nan), np.zeros(n, np.bool_), 0.0, 0.0, 0.0
    )
