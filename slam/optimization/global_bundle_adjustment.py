"""Global bundle adjustment of a whole map."""

from dataclasses import dataclass

import numpy as np

from dslab.slam.optimization import _ba_kernels as kernels
from dslab.slam.optimization import ceres
from dslab.slam.optimization.pose import CHI2_2DOF


@dataclass(frozen=True)
class GlobalBundleResult:
    """An adjusted map.

    Attributes:
        T_cam_map: (C, 4, 4) poses; the first is the input's.
        points: (P, 3).
        chi2: (M,) squared error of each observation in units of its variance; infinite behind the camera.
        cost_initial, cost_final: sum of the robust squared errors of the observations in front of the camera.
    """

    T_cam_map: np.ndarray
    points: np.ndarray
    chi2: np.ndarray
    cost_initial: float
    cost_final: float


def global_bundle_adjust(
    T_cam_map: np.ndarray,
    points: np.ndarray,
    obs_cam: np.ndarray,
    obs_point: np.ndarray,
    pixels: np.ndarray,
    octave: np.ndarray,
    sigma: np.ndarray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    iterations: int = 10,
    apart: bool = False,
) -> GlobalBundleResult:
    """Minimise the Huber loss over all points and all poses but the first.

    Scale is not observable; the distance of two cameras fixes it. Observations behind their camera, and of
    points that have no two others, are not used. The solver has one thread, so that the same input gives
    the same bits.

    Args:
        T_cam_map: (C, 4, 4) rigid poses, C >= 2.
        points: (P, 3) frame map.
        obs_cam: (M,) camera of each observation.
        obs_point: (M,) point of each observation.
        pixels: (M, 2) undistorted keypoints, px.
        octave: (M,) pyramid level of each keypoint.
        sigma: (L,) standard deviation of the keypoints of each level, px.
        fx: focal length along x, px.
        fy: focal length along y, px.
        cx: principal point along x, px.
        cy: principal point along y, px.
        iterations: most steps.
        apart: work in a separate process, so that other threads can run.

    Raises:
        ValueError: fewer than two cameras or no observation.
        RuntimeError: that process has failed.

    Source: Mur-Artal, Montiel, Tardos, "ORB-SLAM", 2015, appendix (full bundle adjustment).
    """
    if len(T_cam_map) < 2 or not len(obs_cam):
        raise ValueError("global bundle adjustment needs two cameras and observations")
    camera, point = np.ascontiguousarray(obs_cam, np.int32), np.ascontiguousarray(obs_point, np.int32)
    xy, weights = np.ascontiguousarray(pixels, np.float64), 1.0 / sigma[octave] ** 2
    intrinsics = np.array([fx, fy, cx, cy], np.float64)
    start, _ = kernels.errors(T_cam_map, points, camera, point, xy, weights, intrinsics)
    seen = np.isfinite(start)
    seen &= (np.bincount(point[seen], minlength=len(points)) > 1)[point]
    T, moved = (ceres.solve_apart if apart else ceres.solve)(
        np.asarray(T_cam_map, np.float64), np.asarray(points, np.float64), camera[seen], point[seen],
        (xy / sigma[octave][:, None])[seen], np.asarray(octave)[seen], sigma, intrinsics, iterations,
    )  # fmt: skip
    chi2, _ = kernels.errors(T, moved, camera, point, xy, weights, intrinsics)
    return GlobalBundleResult(T, moved, chi2, _robust_cost(start), _robust_cost(chi2))


def _robust_cost(chi2: np.ndarray) -> float:
    """Sum of the Huber losses of the squared errors in front of the camera."""
    seen = chi2[np.isfinite(chi2)]
    far = seen > CHI2_2DOF
    return float(seen[~far].sum() + (2 * ceres.HUBER_DELTA * np.sqrt(seen[far]) - CHI2_2DOF).sum())
