"""Bundle adjustment of keyframes and map points together."""

from dataclasses import dataclass

import numpy as np

from dslab.slam.optimization import _ba_kernels as kernels
from dslab.slam.optimization._se3 import orthonormalise
from dslab.slam.optimization.pose import CHI2_2DOF
from dslab.slam.optimization.student import CHI2_99

_HUBER_DELTA = float(np.sqrt(CHI2_2DOF))
_FINAL_ITERATIONS = 10
_STUDENT = -1.0


@dataclass(frozen=True)
class BundleResult:
    """Result of bundle adjustment.

    Attributes:
        T_cam_map: (C, 4, 4) poses; those of fixed cameras are the input's.
        points: (P, 3) points; those with fewer than two observations are the input's.
        chi2: (M,) squared error of each observation in units of its variance, without the robust loss;
            infinite where the depth is not positive.
        positive_depth: (M,) bool.
        cost_initial, cost_final: sum of the robust squared errors of the observations used.
    """

    T_cam_map: np.ndarray
    points: np.ndarray
    chi2: np.ndarray
    positive_depth: np.ndarray
    cost_initial: float
    cost_final: float


def bundle_adjust(
    T_cam_map: np.ndarray,
    fixed: np.ndarray,
    points: np.ndarray,
    obs_cam: np.ndarray,
    obs_point: np.ndarray,
    pixels: np.ndarray,
    inv_sigma2: np.ndarray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    iterations: int,
    huber_delta: float,
) -> BundleResult:
    """Minimise the reprojection error over the free cameras and all points.

    Levenberg-Marquardt with the points eliminated (Schur complement); no step that raises the cost is
    kept. Points with fewer than two observations and non-finite observations are not used.

    Args:
        T_cam_map: (C, 4, 4) poses.
        fixed: (C,) bool, cameras that fix the gauge; at least one. With one, the damping fixes the scale.
        points: (P, 3) frame map.
        obs_cam: (M,) camera of each observation.
        obs_point: (M,) point of each observation.
        pixels: (M, 2) undistorted keypoints, px.
        inv_sigma2: (M,) information of each keypoint, 1/px².
        fx: focal length along x, px.
        fy: focal length along y, px.
        cx: principal point along x, px.
        cy: principal point along y, px.
        iterations: most steps tried.
        huber_delta: threshold of the Huber loss in sigma; no robust loss if <= 0.

    Raises:
        ValueError: no camera is fixed, or an observation names a camera or point that does not exist.

    Source: Triggs et al., "Bundle Adjustment: A Modern Synthesis", 1999, section 6 (Schur complement);
        Nielsen, "Damping Parameter in Marquardt's Method", 1999.
    """
    problem = _Problem.checked(
        T_cam_map, fixed, points, obs_cam, obs_point, pixels, inv_sigma2, fx, fy, cx, cy
    )
    return problem.adjusted(problem.finite(), iterations, max(huber_delta, 0.0))


def local_bundle_adjust(
    T_cam_map: np.ndarray,
    fixed: np.ndarray,
    points: np.ndarray,
    obs_cam: np.ndarray,
    obs_point: np.ndarray,
    pixels: np.ndarray,
    inv_sigma2: np.ndarray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    robust_iterations: int = 50,
) -> tuple[BundleResult, np.ndarray]:
    """Bundle-adjust with a robust loss on all observations, then without on the inliers.

    Along a wall that fills the view, turn and step look alike to a pixel, and the robust loss converges
    slowly. Stopped early, it leaves the poses where tracking has put them, the observations that contradict
    them are dropped, new points follow, and the map slides into another motion.

    Arguments and errors as :func:`bundle_adjust`; besides:

    Args:
        robust_iterations: most steps tried with the robust loss; it ends once they gain nothing.

    Returns:
        The result, whose ``chi2`` and ``positive_depth`` cover all observations and whose costs are those
        of the second stage, and the inliers (M,) bool: within chi-square at 95% and in front of the camera
        at the end.

    Source: Mur-Artal, Montiel, Tardós, "ORB-SLAM", 2015, section VI-D (local bundle adjustment).
    """
    problem = _Problem.checked(
        T_cam_map, fixed, points, obs_cam, obs_point, pixels, inv_sigma2, fx, fy, cx, cy
    )
    robust = problem.adjusted(problem.finite(), robust_iterations, _HUBER_DELTA)
    problem.T, problem.points = robust.T_cam_map, robust.points
    result = problem.adjusted(robust.chi2 <= CHI2_2DOF, _FINAL_ITERATIONS, 0.0)
    return result, result.chi2 <= CHI2_2DOF


def likeliest_bundle(
    T_cam_map: np.ndarray,
    fixed: np.ndarray,
    points: np.ndarray,
    obs_cam: np.ndarray,
    obs_point: np.ndarray,
    pixels: np.ndarray,
    inv_sigma2: np.ndarray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    iterations: int = 60,
) -> tuple[BundleResult, np.ndarray]:
    """Bundle-adjust where errors are of Student's t: no error is cut off, those far out weigh less.

    Arguments and errors as :func:`bundle_adjust`, but for the loss.

    Returns:
        The result, and the observations (M,) bool that are within what 99 of 100 are, in front of the camera.

    Source: ``slam.optimization.student``.
    """
    problem = _Problem.checked(
        T_cam_map, fixed, points, obs_cam, obs_point, pixels, inv_sigma2, fx, fy, cx, cy
    )
    result = problem.adjusted(problem.finite(), iterations, _STUDENT)
    return result, result.chi2 <= CHI2_99


@dataclass
class _Problem:
    """Arrays of a problem in the types and layouts that the kernels take."""

    T: np.ndarray
    slot: np.ndarray
    points: np.ndarray
    camera: np.ndarray
    point: np.ndarray
    pixels: np.ndarray
    weights: np.ndarray
    intrinsics: np.ndarray

    @classmethod
    def checked(
        cls, T_cam_map, fixed, points, obs_cam, obs_point, pixels, inv_sigma2, fx, fy, cx, cy
    ) -> "_Problem":
        fixed = np.asarray(fixed, np.bool_)
        if not fixed.any():
            raise ValueError("no camera is fixed: the gauge is free")
        camera = np.ascontiguousarray(obs_cam, np.int32)
        point = np.ascontiguousarray(obs_point, np.int32)
        for name, index, size in (("obs_cam", camera, len(fixed)), ("obs_point", point, len(points))):
            if len(index) and not 0 <= index.min() <= index.max() < size:
                raise ValueError(f"{name} is out of range: [{index.min()}, {index.max()}] of {size}")
        return cls(
            np.ascontiguousarray(T_cam_map, np.float64),
            np.where(fixed, -1, np.cumsum(~fixed) - 1),
            np.ascontiguousarray(points, np.float64).reshape(-1, 3),
            camera,
            point,
            np.ascontiguousarray(pixels, np.float64).reshape(-1, 2),
            np.ascontiguousarray(inv_sigma2, np.float64),
            np.array([fx, fy, cx, cy], np.float64),
        )

    def finite(self) -> np.ndarray:
        """Mask (M,) bool of the finite observations."""
        observation = np.isfinite(self.pixels.sum(axis=1) + self.weights)
        return observation & np.isfinite(self.points.sum(axis=1))[self.point]

    def adjusted(self, used: np.ndarray, iterations: int, huber_delta: float) -> BundleResult:
        """Optimise on the ``used`` (M,) observations, by Student's t below 0; errors are those of all."""
        T, points = self.T.copy(), self.points.copy()
        rows = np.flatnonzero(used)
        huber2 = float(huber_delta**2) if huber_delta > 0 else float(huber_delta)
        start, order = kernels.sort_by_point(len(points), self.point[rows])
        order = rows[order]
        initial, final = kernels.adjust(
            T, points, start, self.camera[order], self.pixels[order], self.weights[order], self.intrinsics,
            self.slot, int((self.slot >= 0).sum()), int(iterations), huber2,
        )  # fmt: skip
        for k in np.flatnonzero(self.slot >= 0):
            orthonormalise(T[k])
        chi2, positive = kernels.errors(
            T, points, self.camera, self.point, self.pixels, self.weights, self.intrinsics
        )
        return BundleResult(T, points, chi2, positive, initial, final)
