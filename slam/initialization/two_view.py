"""Two-view reconstruction: relative pose and first points from matches alone.

A homography (planar or distant scene) and an essential matrix (general scene) are estimated in parallel.
Over a short baseline both explain the matches equally well and neither motion is accurate. Their motions are
therefore only starting points of a search for all motions that explain the matches. The best is accepted if
its points have enough parallax and no clearly different motion explains the matches about as well: neither
another minimum (ambiguous) nor a motion of the same minimum (ill conditioned).

Source: two models and the parallax: Mur-Artal, Montiel, Tardós, "ORB-SLAM", 2015, section IV.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dslab.slam.core.settings import setting, settings
from dslab.slam.initialization import _two_view_models as models
from dslab.slam.initialization._two_view_refinement import RefinedMotion
from dslab.slam.initialization._two_view_search import motions_around, search_motions

Reason = Literal[
    "", "too_few_matches", "no_model", "low_parallax", "few_points", "ambiguous", "ill_conditioned"
]
Model = Literal["homography", "essential"]

_CHI2_1DOF = 3.841
_ROUNDING = 1e-9
_LINE_SIGMAS = 5.0
"""Least scatter of the keypoints about a line, below which motions cannot be distinguished."""

_MAX_ERROR_SIGMAS = 2.0
"""Largest distance between a triangulated point's reprojection and its keypoint."""


@settings
class TwoViewConfig:
    """Settings of two-view reconstruction."""

    sigma_px: float = setting(1.0, "nominal noise of a keypoint: decides which matches fit a motion")
    min_matches: int = setting(100, "fewest matches")
    min_points: int = setting(50, "fewest triangulated points of a reconstruction")
    min_parallax_deg: float = setting(1.0, "parallax that min_points points must reach")
    far_parallax_deg: float = setting(0.3, "parallax below which a point is too far away to triangulate")
    homography_share: float = setting(0.38, "its share of the scores that makes a scene planar", le=1)
    rival_angle_deg: float = setting(20.0, "angle from which a direction is that of another motion")
    min_lead_sigmas: float = setting(
        3.5, "lead over any other motion; more than three, as frame after frame is tested"
    )
    ransac_threshold_px: float = setting(1.5, "largest distance of a RANSAC inlier to the model")
    ransac_iterations: int = setting(2000, "most RANSAC samples")
    ransac_confidence: float = setting(0.999, "probability to find the model", ge=0, lt=1)


@dataclass(frozen=True)
class TwoViewResult:
    """Relative pose and points of two views.

    Attributes:
        success: the reconstruction is accepted; otherwise pose and points are meaningless.
        reason: reason of a failure.
        model: the geometry that explained the matches better, None if neither was estimated.
        T_2_1: (4, 4) camera 1 to camera 2, translation of unit length.
        points: (N, 3) in the frame of camera 1, units of the baseline; NaN where not triangulated.
        triangulated: (N,) bool.
        parallax_deg: parallax reached by ``min_points`` of the matches.
        score_h, score_e: scores of homography and essential matrix, higher is better.
        T_2_1_rival: (4, 4) the clearly different motion over which the lead of ``T_2_1`` is least, None
            without any.
        lead_sigmas: that lead; errors that matches have in common make it seem more certain than it is.
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
    T_2_1_rival: np.ndarray | None = None
    lead_sigmas: float = np.inf


def two_view_reconstruction(
    pixels_1: np.ndarray,
    pixels_2: np.ndarray,
    K: np.ndarray,
    rng: np.random.Generator,
    config: TwoViewConfig | None = None,
    scale: np.ndarray | None = None,
) -> TwoViewResult:
    """Estimate the relative pose of two views and their common points.

    Args:
        pixels_1: (N, 2) undistorted keypoints of view 1, px.
        pixels_2: (N, 2) the matched keypoints of view 2, px.
        K: (3, 3) camera matrix of both.
        rng: stream of the sampling; the same state gives the same result.
        config: settings, the defaults if None.
        scale: (N,) noise of each match in units of ``sigma_px``, such as the scale of its pyramid level;
            one if None.

    Raises:
        ValueError: the views have different numbers of keypoints, or not all are finite, or a scale is
            missing or not positive.
    """
    config = config or TwoViewConfig()
    pixels_1, pixels_2, scale = _validated(pixels_1, pixels_2, scale)
    failure = failed(len(pixels_1))
    if len(pixels_1) < config.min_matches:
        return replace(failure, reason="too_few_matches")
    K = np.ascontiguousarray(K, np.float64)
    K_inv = np.linalg.inv(K)
    sigma_px = config.sigma_px * scale
    H, E = models.estimate_models(
        pixels_1, pixels_2, K, int(rng.integers(2**31)),
        config.ransac_threshold_px, config.ransac_confidence, config.ransac_iterations,
    )  # fmt: skip
    F = None if E is None else K_inv.T @ E @ K_inv
    score_h, _ = models.homography_score(H, pixels_1, pixels_2, sigma_px)
    score_e, _ = models.epipolar_score(F, pixels_1, pixels_2, sigma_px)
    failure = replace(failure, score_h=score_h, score_e=score_e)
    if score_h + score_e <= 0.0:
        return replace(failure, reason="no_model")
    flat = score_h >= config.homography_share * (score_h + score_e)
    failure = replace(failure, model="homography" if flat else "essential")
    starts = [] if H is None else models.homography_motions(H, K)
    starts += [] if E is None else models.essential_motions(E)
    if not starts:
        # A homography without translation: the camera only rotated.
        return replace(failure, reason="low_parallax")
    return _best_motion(starts, pixels_1, pixels_2, K, sigma_px, failure, config)


def _validated(
    pixels_1: np.ndarray, pixels_2: np.ndarray, scale: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    pixels_1 = np.ascontiguousarray(pixels_1, np.float64).reshape(-1, 2)
    pixels_2 = np.ascontiguousarray(pixels_2, np.float64).reshape(-1, 2)
    scale = np.ones(len(pixels_1)) if scale is None else np.ascontiguousarray(scale, np.float64)
    if pixels_1.shape != pixels_2.shape or not np.isfinite(pixels_1.sum() + pixels_2.sum()):
        raise ValueError(f"matches are not pairs of finite pixels: {len(pixels_1)} and {len(pixels_2)} rows")
    if scale.shape != (len(pixels_1),) or not (scale > 0.0).all():
        raise ValueError(f"not one positive scale for each of {len(pixels_1)} matches")
    return pixels_1, pixels_2, scale


def _best_motion(
    starts: list[np.ndarray],
    pixels_1: np.ndarray,
    pixels_2: np.ndarray,
    K: np.ndarray,
    sigma_px: np.ndarray,
    failure: TwoViewResult,
    config: TwoViewConfig,
) -> TwoViewResult:
    """Search for all motions, triangulate under the best, and accept or reject it."""
    focal, centre = np.array([K[0, 0], K[1, 1]]), K[:2, 2]
    rays_1, rays_2 = (np.ascontiguousarray((pixels - centre) / focal) for pixels in (pixels_1, pixels_2))
    sigma = sigma_px / focal.mean()
    (best, *others), noise = search_motions(starts, rays_1, rays_2, sigma)
    inliers = noise**2 * (best.errors**2).sum(axis=1) <= _CHI2_1DOF
    if inliers.sum() < config.min_points:
        return replace(failure, reason="few_points")
    tried = models.try_motion(
        best.T_2_1, pixels_1, pixels_2, inliers, K, _MAX_ERROR_SIGMAS * sigma_px, config.far_parallax_deg
    )
    parallax_deg = float(np.sort(tried.parallax_deg[inliers])[-config.min_points])
    lead, rival = _least_lead(best, others, config)
    reason: Reason = ""
    if parallax_deg < config.min_parallax_deg:
        reason = "low_parallax"
    elif tried.triangulated.sum() < config.min_points:
        reason = "few_points"
    elif lead < config.min_lead_sigmas:
        reason = "ambiguous"
    elif _in_line(pixels_1[inliers], config) or _in_line(pixels_2[inliers], config):
        reason = "ill_conditioned"
    else:
        around = motions_around(best, config.rival_angle_deg, rays_1, rays_2, noise * sigma)
        if _least_lead(best, around, config)[0] < config.min_lead_sigmas:
            reason = "ill_conditioned"
    if reason:
        return replace(failure, reason=reason, parallax_deg=parallax_deg)
    return replace(
        failure,
        success=True,
        T_2_1=tried.T_2_1,
        points=tried.points,
        triangulated=tried.triangulated,
        parallax_deg=parallax_deg,
        T_2_1_rival=None if np.isinf(lead) else rival.T_2_1,
        lead_sigmas=lead,
    )


def _in_line(pixels: np.ndarray, config: TwoViewConfig) -> bool:
    scatter = np.linalg.svd(pixels - pixels.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(pixels))
    return bool(scatter < _LINE_SIGMAS * config.sigma_px)


def _least_lead(
    best: RefinedMotion, others: list[RefinedMotion], config: TwoViewConfig
) -> tuple[float, RefinedMotion]:
    """Least lead of the best motion, in sigmas, and the clearly different motion over which it is so.

    Without any, the lead is infinite and the motion the best one.
    """
    same = np.cos(np.deg2rad(config.rival_angle_deg)) + _ROUNDING
    rivals = [m for m in others if best.T_2_1[:3, 3] @ m.T_2_1[:3, 3] <= same]
    leads = [lead_sigmas(m.costs - best.costs, config.min_lead_sigmas) for m in rivals]
    return min(zip(leads, rivals, strict=True), key=lambda found: found[0], default=(np.inf, best))


def lead_sigmas(lead: np.ndarray, min_scatter: float) -> float:
    """Standard deviations by which one of two motions explains what is seen better than the other.

    The lead is compared with the scatter of its single contributions, which is measured and so valid for any
    noise, and with the noise itself if they all agree.

    Args:
        lead: (N,) cost under the other motion less that under the first, in units of the variance.
        min_scatter: least scatter of the sum.

    Source: Vuong, "Likelihood ratio tests for model selection and non-nested hypotheses", 1989.
    """
    scatter = max(np.sqrt(len(lead)) * lead.std(), min_scatter, _ROUNDING)
    return float(lead.sum() / scatter)


def failed(n: int) -> TwoViewResult:
    """No reconstruction of ``n`` matches, without a reason yet."""
    return TwoViewResult(
        False, "", None, np.eye(4), np.full((n, 3), np.nan), np.zeros(n, np.bool_), 0.0, 0.0, 0.0
    )
