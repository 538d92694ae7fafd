"""Similarity between two maps from common points: closed form, RANSAC, refinement.

``S_1_2`` takes frame 2 to frame 1: ``p_1 = s R p_2 + t``.
"""

from dataclasses import dataclass

import numpy as np

from dslab.slam.optimization import _sim3_kernels as kernels

_CONFIDENCE = 0.999
_REFITS = 3
_ITERATIONS = 20
"""Most steps of a refinement; it ends once they gain nothing."""
# Smallest relative standard deviation of a map point's depth.
_MIN_DEPTH_SIGMA = 1e-3


@dataclass(frozen=True)
class Sim3Result:
    """A similarity and its inliers.

    Attributes:
        success: there are enough inliers; otherwise the similarity is the identity or the best one found.
        s, R, t: scale, rotation (3, 3), translation (3,) of S_1_2.
        inliers: (N,) bool, pairs with small reprojection errors in both cameras.
    """

    success: bool
    s: float
    R: np.ndarray
    t: np.ndarray
    inliers: np.ndarray


def sim3_matrix(s: float, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(4, 4) matrix ``[s R | t]``."""
    S = np.eye(4)
    S[:3, :3], S[:3, 3] = s * R, t
    return S


def sim3_decompose(S: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Scale, rotation (3, 3) and translation (3,) of a (4, 4) similarity.

    Raises:
        ValueError: the linear part is a reflection or singular.
    """
    determinant = float(np.linalg.det(S[:3, :3]))
    if not determinant > 0.0:
        raise ValueError(f"not a similarity: determinant {determinant}")
    s = determinant ** (1.0 / 3.0)
    return s, S[:3, :3] / s, S[:3, 3].copy()


def sim3_inverse(S: np.ndarray) -> np.ndarray:
    """Inverse of a (4, 4) similarity."""
    s, R, t = sim3_decompose(S)
    return sim3_matrix(1.0 / s, R.T, -R.T @ t / s)


def moved(S: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Poses (..., 4, 4) in another map, by a (4, 4) similarity to it: they stay rigid."""
    s, R, t = sim3_decompose(S)
    out = T.copy()
    out[..., :3, :3] = R @ T[..., :3, :3]
    out[..., :3, 3] = s * T[..., :3, 3] @ R.T + t
    return out


def horn_sim3(points_a: np.ndarray, points_b: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Least-squares similarity from ``points_b`` to ``points_a``: ``p_a = s R p_b + t``.

    Args:
        points_a: (N, 3) points in frame a.
        points_b: (N, 3) the same points in frame b.

    Returns:
        s, R (3, 3), t (3,), the least-squares solution.

    Raises:
        ValueError: fewer than three points, or collinear points: the rotation is not determined.

    Source: Horn, "Closed-form solution of absolute orientation using unit quaternions", 1987, sections 2-4.
    """
    a = np.ascontiguousarray(points_a, np.float64).reshape(-1, 3)
    b = np.ascontiguousarray(points_b, np.float64).reshape(-1, 3)
    if len(a) != len(b):
        raise ValueError(f"{len(a)} points against {len(b)}")
    found, s, R, t = kernels.horn(a, b, np.arange(len(a)), False)
    if not found:
        raise ValueError(f"{len(a)} points do not determine a similarity")
    return s, R, t


def ransac_sim3(
    points_1cam: np.ndarray,
    points_2cam: np.ndarray,
    pixels_1: np.ndarray,
    pixels_2: np.ndarray,
    sigma2_1: np.ndarray,
    sigma2_2: np.ndarray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    rng: np.random.Generator,
    max_iterations: int = 300,
    min_inliers: int = 20,
    chi2: float = 9.21,
    fixed_scale: bool = False,
) -> Sim3Result:
    """Estimate the similarity between two cameras' frames from point pairs with many outliers.

    Args:
        points_1cam: (N, 3) points in the frame of camera 1, units of its map.
        points_2cam: (N, 3) the same points in the frame of camera 2, units of its map.
        pixels_1: (N, 2) undistorted keypoints in camera 1, px.
        pixels_2: (N, 2) undistorted keypoints in camera 2, px.
        sigma2_1: (N,) variances of the keypoints in camera 1, px².
        sigma2_2: (N,) variances of the keypoints in camera 2, px².
        fx: focal length of both cameras along x, px.
        fy: focal length of both cameras along y, px.
        cx: principal point along x, px.
        cy: principal point along y, px.
        rng: stream of the samples.
        max_iterations: most samples; fewer if most pairs are inliers.
        min_inliers: fewest inliers.
        chi2: bound on a pair's squared error in each image, in units of its variance.
        fixed_scale: keep s = 1.

    Source: Mur-Artal, Montiel, Tardós, "ORB-SLAM", 2015, section VII-B, with the closed form of Horn, 1987.
    """
    pairs = _Pairs.of(points_1cam, points_2cam, pixels_1, pixels_2, sigma2_1, sigma2_2, fx, fy, cx, cy)
    n = len(pairs.points_1)
    if n < max(min_inliers, 3):
        return _nothing(n)
    found, s, R, t, inliers = kernels.ransac(
        *pairs.arrays(), chi2, _triplets(rng, n, max_iterations), fixed_scale, _CONFIDENCE
    )
    if not found:
        return _nothing(n)
    for _ in range(_REFITS):
        found, s_fit, R_fit, t_fit = kernels.horn(
            pairs.points_1, pairs.points_2, np.flatnonzero(inliers), fixed_scale
        )
        if not found:
            break
        refitted = kernels.agreeing(*pairs.arrays(), chi2, s_fit, R_fit, t_fit)
        if refitted.sum() <= inliers.sum():
            break
        s, R, t, inliers = s_fit, R_fit, t_fit, refitted
    return Sim3Result(bool(inliers.sum() >= min_inliers), s, R, t, inliers)


def optimize_sim3(
    s: float,
    R: np.ndarray,
    t: np.ndarray,
    points_1cam: np.ndarray,
    points_2cam: np.ndarray,
    pixels_1: np.ndarray,
    pixels_2: np.ndarray,
    sigma2_1: np.ndarray,
    sigma2_2: np.ndarray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    min_inliers: int = 20,
    chi2: float = 10.0,
    fixed_scale: bool = False,
) -> Sim3Result:
    """Refine S_1_2 by reprojection errors in both cameras and by depths.

    With a Huber loss on all pairs, then by least squares on the inliers of both cameras.
    Reprojection determines scale poorly if the two cameras are close, and not at all if they are one frame in
    two maps; the ratio of a pair's depths in the two maps then determines it, weighted by its own scatter.

    Args:
        s: initial scale.
        R: (3, 3) initial rotation.
        t: (3,) initial translation, units of map 1.
        points_1cam: (N, 3) points in the frame of camera 1, units of its map.
        points_2cam: (N, 3) the same points in the frame of camera 2, units of its map.
        pixels_1: (N, 2) undistorted keypoints in camera 1, px.
        pixels_2: (N, 2) undistorted keypoints in camera 2, px.
        sigma2_1: (N,) variances of the keypoints in camera 1, px².
        sigma2_2: (N,) variances of the keypoints in camera 2, px².
        fx: focal length of both cameras along x, px.
        fy: focal length of both cameras along y, px.
        cx: principal point along x, px.
        cy: principal point along y, px.
        min_inliers: fewest inliers in the end.
        chi2: bound on a pair's squared error in each image, in units of its variance.
        fixed_scale: keep the scale.

    Source: ORB-SLAM, 2015, appendix (relative Sim(3) optimisation).
    """
    pairs = _Pairs.of(points_1cam, points_2cam, pixels_1, pixels_2, sigma2_1, sigma2_2, fx, fy, cx, cy)
    S = np.ascontiguousarray(sim3_matrix(float(s), np.asarray(R, np.float64), np.asarray(t, np.float64)))
    n = len(pairs.points_1)
    if n < max(min_inliers, 3):
        return _nothing(n)
    everything = np.isfinite(pairs.points_1.sum(axis=1) + pairs.points_2.sum(axis=1))
    weight = depth_information(S, pairs.points_1, pairs.points_2)
    kernels.refine(S, *pairs.arrays(), everything, weight, chi2, fixed_scale, _ITERATIONS)
    inliers = kernels.agreeing(*pairs.arrays(), chi2, *sim3_decompose(S))
    if inliers.sum() >= 3:
        weight = depth_information(S, pairs.points_1[inliers], pairs.points_2[inliers])
        kernels.refine(S, *pairs.arrays(), inliers, weight, 0.0, fixed_scale, _ITERATIONS)
        inliers = kernels.agreeing(*pairs.arrays(), chi2, *sim3_decompose(S))
    s, R, t = sim3_decompose(S)
    return Sim3Result(bool(inliers.sum() >= min_inliers), s, R, t, inliers)


@dataclass(frozen=True)
class _Pairs:
    """Arrays of point pairs in the types and layouts that the kernels take."""

    points_1: np.ndarray
    points_2: np.ndarray
    pixels_1: np.ndarray
    pixels_2: np.ndarray
    weights_1: np.ndarray
    weights_2: np.ndarray
    intrinsics: np.ndarray

    @classmethod
    def of(cls, points_1, points_2, pixels_1, pixels_2, sigma2_1, sigma2_2, fx, fy, cx, cy) -> "_Pairs":
        return cls(
            np.ascontiguousarray(points_1, np.float64).reshape(-1, 3),
            np.ascontiguousarray(points_2, np.float64).reshape(-1, 3),
            np.ascontiguousarray(pixels_1, np.float64).reshape(-1, 2),
            np.ascontiguousarray(pixels_2, np.float64).reshape(-1, 2),
            1.0 / np.ascontiguousarray(sigma2_1, np.float64),
            1.0 / np.ascontiguousarray(sigma2_2, np.float64),
            np.array([fx, fy, cx, cy], np.float64),
        )

    def arrays(self) -> tuple[np.ndarray, ...]:
        return (
            self.points_1, self.points_2, self.pixels_1, self.pixels_2,
            self.weights_1, self.weights_2, self.intrinsics,
        )  # fmt: skip


def depth_information(S: np.ndarray, points_1cam: np.ndarray, points_2cam: np.ndarray) -> float:
    """Information of the logarithm of a depth ratio, from its median absolute deviation under ``S``.

    Args:
        S: (4, 4) S_1_2.
        points_1cam: (N, 3) points in the frame of camera 1.
        points_2cam: (N, 3) the same points in the frame of camera 2.

    Returns:
        1 / variance, 0 if no pair has two positive depths.
    """
    z_1, z_2 = points_1cam[:, 2], points_2cam @ S[2, :3] + S[2, 3]
    front = (z_1 > 0.0) & (z_2 > 0.0)
    if not front.any():
        return 0.0
    ratio = np.log(z_2[front] / z_1[front])
    deviation = 1.4826 * float(np.median(np.abs(ratio - np.median(ratio))))
    return 1.0 / max(deviation, _MIN_DEPTH_SIGMA) ** 2


def _triplets(rng: np.random.Generator, n: int, count: int) -> np.ndarray:
    """(count, 3) int64 triplets of distinct rows below ``n``, uniform."""
    a = rng.integers(n, size=count)
    b = rng.integers(n - 1, size=count)
    b += b >= a
    c = rng.integers(n - 2, size=count)
    c += c >= np.minimum(a, b)
    c += c >= np.maximum(a, b)
    return np.stack([a, b, c], axis=1)


def _nothing(n: int) -> Sim3Result:
    return Sim3Result(False, 1.0, np.eye(3), np.zeros(3), np.zeros(n, np.bool_))
