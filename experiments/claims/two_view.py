"""Two views of one path, more and less far apart: what their matches alone tell of their relative pose.

Frames with exact depth and pose are rendered once per scene and world. Nothing of a SLAM is asked beyond its
features; no pose is rejected for its small parallax, as those are the subject.

Source: Huang et al., Dual-SLAM, 2020, Sec. II, Fig. 2 and Sec. V-C.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import cv2
import numpy as np
from pydantic import Field, model_validator

from dslab.experiments.claims.plain_ransac import InlierCount, plain_ransac
from dslab.experiments.claims.spec import ClaimSpec, Row, Unit
from dslab.experiments.claims.two_view_bound import Rays, median_error_deg, pose_covariance, refined
from dslab.experiments.eq1.conditioning import angle_deg, magsac
from dslab.experiments.evaluation.alignment import rotation_angle_deg
from dslab.experiments.runs.execution import slam_camera
from dslab.experiments.runs.slam_settings import parse_slam_settings
from dslab.scenarios.seeds import rng_for
from dslab.sim.sequence import Sequence
from dslab.sim.sequence_rendering import render_sequence
from dslab.sim.unfinished import scratch_folder
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import Features
from dslab.slam.features.orb import OrbExtractor
from dslab.slam.matching.brute_force import match_brute_force

_LEAST_BASELINE_M = 1e-6
_LEAST_MATCHES = 8
"""Five matches are fitted exactly, whether right or wrong."""
_FARTHEST = 1e6
"""In baselines. OpenCV's default of 50 excludes most points of a narrow pair from the choice of poses."""
_SMOOTH = 0.05
"""Relative difference of the depths around a keypoint above which they are not of one surface."""
_SIGMAS = 3.0
_MEDIAN_WITHIN = 0.67237
"""Median of the |z| below 3 of a standard normal z: half of P(|z| < 3) = .9973 lies below it."""


class TwoViewSpec(ClaimSpec):
    """Pairs of frames of every scene and world, and how their pose is estimated."""

    kind: Literal["two_view"]
    settings: dict[str, Any] = Field(
        default_factory=dict, description="of the features, as in a settings file of `dslab run`"
    )
    gaps: tuple[int, ...] = Field(min_length=2, description="frames from the first to the second of a pair")
    starts: int = Field(1, ge=1, le=100, description="pairs of every gap in a world")
    match_distance: int = Field(50, ge=0, le=256, description="most differing bits of two descriptors")
    match_ratio: float = Field(0.8, gt=0, le=1, description="of the best distance to the second best")
    threshold_px: float = Field(1.0, gt=0, le=100, description="Sampson error of an inlier")
    iterations: tuple[int, ...] = Field(
        (), description="numbers of samples of plain RANSAC; none: MAGSAC++ with local optimisation"
    )
    parallax_edges_deg: tuple[float, ...] = Field(
        (0.25, 0.5, 1, 2, 4, 8, 16, 32), min_length=2, description="of the bins of parallax in the figures"
    )

    @model_validator(mode="after")
    def _check(self) -> "TwoViewSpec":
        for name in ("gaps", "iterations", "parallax_edges_deg"):
            values = getattr(self, name)
            if sorted({*values}) != list(values) or (values and values[0] <= 0):
                raise ValueError(f"{name} do not increase from above 0, put them in order")
        parse_slam_settings(self.settings, (), lambda at: ".".join(map(str, ("settings", *at))))
        return self


def units(spec: TwoViewSpec) -> list[Unit]:
    """A unit is a scene in a world."""
    return [{"scene": scene, "world": world} for world in range(spec.worlds) for scene in spec.cells]


def measure(spec: TwoViewSpec, unit: Unit) -> list[Row]:
    """A row per pair, of plain RANSAC one per number of samples."""
    scenario = spec.scenario(unit["scene"], unit["world"])
    with scratch_folder() as folder:
        sequence = render_sequence(scenario, cache_dir=folder, depth=True)
        rows: list[Row] = []
        for gap, pair in _pairs(spec, sequence):
            seed = spec.seed(unit["scene"], unit["world"], "pair", pair.first, gap)
            about = {"gap": gap, "first": pair.first, **pair.columns()}
            estimates = _by_samples if spec.iterations else _by_magsac
            rows += [about | own for own in estimates(spec, pair, seed)]
    return rows


@dataclass(frozen=True)
class Pair:
    """Matches of two frames and the truth about them.

    Attributes:
        first: number of the first frame.
        R, t: (3, 3) and (3,) true motion, view 1 to view 2, metres.
        rays: the matches.
        depth_m: (N,) exact depth in view 1; NaN at the edge of a surface, where a keypoint has none.
        error: (N, 2) true reprojection errors in view 2, over what noise of 1 px at octave 0 in both
            keypoints lets expect.
        focal_px: mean focal length.
    """

    first: int
    R: np.ndarray
    t: np.ndarray
    rays: Rays
    depth_m: np.ndarray
    error: np.ndarray
    focal_px: float

    @property
    def baseline_m(self) -> float:
        """Distance of the two cameras."""
        return float(np.linalg.norm(self.t))

    @property
    def noise_px(self) -> float | None:
        """Spread of a keypoint of octave 0, from the true errors of the matches; None with too few.

        The median of the absolute errors within three spreads, over what it is for a normal one cut there.
        It is found by iteration from a spread of 1 px, so that wrong matches do not widen it.
        """
        errors = np.abs(self.error[np.isfinite(self.error).all(axis=1)])
        sigma = 1.0
        for _ in range(50):
            within = errors[errors <= _SIGMAS * sigma]
            if len(within) < 2 * _LEAST_MATCHES:
                return None
            sigma = float(np.median(within)) / _MEDIAN_WITHIN
        return sigma or None

    def is_right(self) -> np.ndarray:
        """(N,) bool: the match is of one point of the world, by its true error."""
        sigma = self.noise_px or 0.0
        return np.linalg.norm(np.nan_to_num(self.error, nan=np.inf), axis=1) <= _SIGMAS * sigma

    def columns(self) -> Row:
        """What is true of the pair, and the bound; angles in degrees."""
        right = self.is_right()
        X = self.rays.x1[right] * self.depth_m[right, None]
        found = pose_covariance(self.R, self.t, self._without_noise(right))
        noise = self.noise_px
        bound = None if found is None or noise is None else [noise**2 * of for of in found]
        return {
            "baseline_m": self.baseline_m,
            "parallax_deg": float(np.median(self._parallax_deg(X))) if len(X) else None,
            "matches": len(self.rays),
            "right": int(right.sum()),
            "noise_px": noise,
            "off_plane": _off_plane(X) if len(X) >= _LEAST_MATCHES else None,
            "bound_rotation_deg": None if bound is None else median_error_deg(bound[0]),
            "bound_direction_deg": None if bound is None else median_error_deg(bound[1]),
        }

    def errors(self, R: np.ndarray, direction: np.ndarray, inliers: np.ndarray, suffix: str = "") -> Row:
        """Errors of an estimate; of depth relative, the median over its inliers, at the true baseline."""
        known = inliers & np.isfinite(self.depth_m)
        depth = _triangulated(R, self.baseline_m * direction, self.rays.of(known))
        relative = np.abs(depth / self.depth_m[known] - 1)
        turn = rotation_angle_deg((R.T @ self.R)[None])[0]
        return {
            f"direction_deg{suffix}": angle_deg(direction, self.t),
            f"rotation_deg{suffix}": float(turn),
            f"depth{suffix}": float(np.median(relative)) if len(relative) else None,
        }

    def _without_noise(self, right: np.ndarray) -> Rays:
        """The right matches where the truth has them: view 2 from view 1 and depth."""
        rays = self.rays.of(right)
        X2 = (rays.x1 * self.depth_m[right, None]) @ self.R.T + self.t
        return Rays(rays.x1, X2 / X2[:, 2:], rays.spread1, rays.spread2)

    def _parallax_deg(self, X: np.ndarray) -> np.ndarray:
        from_second = X + self.R.T @ self.t
        cross = np.linalg.norm(np.cross(X, from_second), axis=1)
        return np.rad2deg(np.arctan2(cross, np.sum(X * from_second, axis=1)))


def _pairs(spec: TwoViewSpec, sequence: Sequence) -> Iterator[tuple[int, Pair]]:
    """Gap and pair; the first frames are the same for every gap, so that gaps differ in the second alone."""
    camera = slam_camera(sequence.camera)
    config, _ = parse_slam_settings(spec.settings, (), lambda at: "settings").of("base", camera)
    extractor = OrbExtractor(camera.width_px, camera.height_px, config.orb)
    features = cache(lambda frame: extractor.extract(sequence.frames[frame]))
    scales = config.orb.scales
    span = len(sequence) - max(spec.gaps)
    for gap in spec.gaps:
        for start in range(spec.starts):
            first = int((start + 0.5) / spec.starts * span)
            a, b = features(first), features(first + gap)
            pair = _pair(spec, sequence, camera, scales, (first, first + gap), (a, b))
            if pair is not None:
                yield gap, pair


def _pair(
    spec: TwoViewSpec,
    sequence: Sequence,
    camera: PinholeCamera,
    scales: np.ndarray,
    frames: tuple[int, int],
    features: tuple[Features, Features],
) -> Pair | None:
    """Match two frames; None if the camera did not move between them."""
    assert sequence.T_world_cam is not None and sequence.depths is not None
    first, second = frames
    T = np.linalg.inv(sequence.T_world_cam[second]) @ sequence.T_world_cam[first]
    R, t = T[:3, :3], T[:3, 3]
    if not np.linalg.norm(t) > _LEAST_BASELINE_M:
        return None
    a, b = features
    matches = match_brute_force(a.descriptors, b.descriptors, spec.match_distance, spec.match_ratio)
    i, j = matches[:, 0], matches[:, 1]
    focal = camera.intrinsics[:2]
    spread1, spread2 = (scales[f.octave[k], None] / focal for f, k in ((a, i), (b, j)))
    rays = Rays(_rays(camera, a.xy[i]), _rays(camera, b.xy[j]), spread1, spread2)
    depth = depth_at(sequence.depths[first], a.xy[i])
    X2 = (rays.x1 * depth[:, None]) @ R.T + t
    nearer = (depth / X2[:, 2])[:, None]  # what a shift in view 1 is in view 2
    expected = np.hypot(spread1 * nearer, spread2)
    error = (rays.x2[:, :2] - X2[:, :2] / X2[:, 2:]) / expected
    error[~(X2[:, 2] > 0)] = np.nan
    return Pair(first, R, t, rays, depth, error, float(focal.mean()))


def _by_magsac(spec: TwoViewSpec, pair: Pair, seed: int) -> Iterator[Row]:
    """The estimate by MAGSAC++; the likeliest pose by its inliers; that near the truth, by the right matches.

    The last tells what of an error is the noise's, and what that of the search.
    """
    found = essential_pose(pair.rays, pair.focal_px, spec.threshold_px, seed)
    if found is None:
        yield {"inliers": None}
        return
    R, direction, inliers = found
    row: Row = {"inliers": int(inliers.sum()), **pair.errors(R, direction, inliers)}
    true_direction, right = pair.t / pair.baseline_m, pair.is_right()
    row["depth_true_pose"] = pair.errors(pair.R, true_direction, inliers)["depth"]
    for suffix, start, used in (
        ("_refined", (R, direction), inliers),
        ("_from_truth", (pair.R, true_direction), right),
    ):
        if used.sum() >= _LEAST_MATCHES:
            row |= pair.errors(*refined(*start, pair.rays.of(used)), used, suffix)
    yield row


def _by_samples(spec: TwoViewSpec, pair: Pair, seed: int) -> Iterator[Row]:
    """A row per number of samples of plain RANSAC, beside the inliers of the true pose."""
    rays, threshold = pair.rays, spec.threshold_px / pair.focal_px
    if len(rays) < _LEAST_MATCHES:
        return
    count = InlierCount(rays.x1, rays.x2, threshold)
    true = int(count.masks((_cross_matrix(pair.t) @ pair.R)[None]).sum())
    found = plain_ransac(rays.x1, rays.x2, threshold, spec.iterations, rng_for(seed, "samples"))
    for samples, (E, inliers) in zip(spec.iterations, found, strict=True):
        R, direction = _pose_of(E, rays, inliers)
        share = inliers.sum() / len(rays)
        yield {
            "samples": samples,
            "inliers": int(inliers.sum()),
            "inliers_true_pose": true,
            "confidence": claimed_confidence(share, samples),
            **pair.errors(R, direction, inliers),
        }


def claimed_confidence(inlier_share: float, samples: int) -> float:
    """Probability that one of the samples has inliers alone: 1 - (1 - w^5)^N.

    Source: Fischler and Bolles, "Random sample consensus", 1981.
    """
    if inlier_share >= 1:
        return 1.0
    return float(-np.expm1(samples * np.log1p(-(inlier_share**5))))


def essential_pose(
    rays: Rays, focal_px: float, threshold_px: float, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Relative pose of two views from an essential matrix, at any parallax.

    Args:
        rays: matches.
        focal_px: focal length. OpenCV is given pixels: with rays and the unit matrix its MAGSAC++ is several
            times as far off, as its scale of the noise is one of pixels.
        threshold_px: Sampson error of an inlier.
        seed: of the sampling.

    Returns:
        (3, 3) rotation and (3,) unit translation, view 1 to view 2, and (N,) inliers; None with fewer than
        eight matches, or if no essential matrix is found.

    Source: Barath, Noskova, Ivashechkin, Matas, "MAGSAC++", CVPR 2020, as in OpenCV.
    """
    if len(rays) < _LEAST_MATCHES:
        return None
    x1, x2 = focal_px * rays.x1[:, :2], focal_px * rays.x2[:, :2]
    K, undistorted = np.diag([focal_px, focal_px, 1.0]), np.zeros(5)
    E, _ = cv2.findEssentialMat(x1, x2, K, K, undistorted, undistorted, magsac(seed, threshold_px))
    if E is None or E.shape != (3, 3) or not np.isfinite(E).all():
        return None
    inliers = InlierCount(rays.x1, rays.x2, threshold_px / focal_px).masks(E[None])[0]
    return *_pose_of(E, rays, inliers), inliers


def _pose_of(E: np.ndarray, rays: Rays, inliers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the four poses of an essential matrix the one with most inliers before both cameras."""
    x1, x2 = rays.x1[:, :2].copy(), rays.x2[:, :2].copy()
    mask = inliers.astype(np.uint8)[:, None]
    _, R, t, *_ = cv2.recoverPose(E, x1, x2, np.eye(3), distanceThresh=_FARTHEST, mask=mask)
    return R, t[:, 0]


def depth_at(depth_m: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Depth at pixels, NaN where it is not of one surface.

    The inverse of depth is linear in the image of a plane, so that interpolating it is exact there.

    Args:
        depth_m: (H, W) depth along the optical axis; 0 for none.
        xy: (N, 2) pixels.

    Returns:
        (N,) float64.
    """
    height, width = depth_m.shape
    x, y = np.asarray(xy, float).T
    left = np.clip(np.floor(x).astype(int), 0, width - 2)
    top = np.clip(np.floor(y).astype(int), 0, height - 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        corners = 1 / np.asarray([depth_m[top + b, left + a] for b in (0, 1) for a in (0, 1)], float)
        smooth = corners.max(axis=0) <= (1 + _SMOOTH) * corners.min(axis=0)
        fx, fy = x - left, y - top
        weights = np.array([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy])
        return np.where(
            smooth & np.isfinite(corners).all(axis=0), 1 / (weights * corners).sum(axis=0), np.nan
        )


def _triangulated(R: np.ndarray, t: np.ndarray, rays: Rays) -> np.ndarray:
    """(N,) depth in view 1 that puts a point of view 1 nearest to its ray in view 2."""
    ahead, across = np.cross(rays.x2, rays.x1 @ R.T), np.cross(rays.x2, t)
    return -np.sum(ahead * across, axis=1) / np.maximum(np.sum(ahead**2, axis=1), 1e-300)


def _off_plane(X: np.ndarray) -> float:
    """Median distance of points (N, 3) from the plane that fits them best, over their median depth."""
    centred = X - X.mean(axis=0)
    normal = np.linalg.svd(centred, full_matrices=False)[2][2]
    return float(np.median(np.abs(centred @ normal)) / np.median(X[:, 2]))


def _rays(camera: PinholeCamera, xy: np.ndarray) -> np.ndarray:
    """(N, 3) rays of pixels (N, 2)."""
    pixels = camera.undistort_points(xy).astype(np.float64)
    fx, fy, cx, cy = camera.intrinsics
    return np.column_stack([(pixels[:, 0] - cx) / fx, (pixels[:, 1] - cy) / fy, np.ones(len(pixels))])


def _cross_matrix(t: np.ndarray) -> np.ndarray:
    return np.cross(np.eye(3), t).T
