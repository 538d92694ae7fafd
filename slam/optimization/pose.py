"""Pose of one camera from map points: motion-only bundle adjustment with outlier rejection."""

from typing import NamedTuple

import numpy as np
from numba import njit

from dslab.slam.optimization._cholesky import whole_rows
from dslab.slam.optimization._se3 import orthonormalise, retract
from dslab.slam.optimization.least_squares import accept_trial, damped_step, is_known, minimise

CHI2_2DOF = 5.991
"""95% of the squared errors of a good observation, in units of its variance, lie below this."""

_CHI2_MEDIAN = 1.386  # half of the squared errors of good observations lie below this
_ROUNDS = 4
_ITERATIONS = 10
_MIN_POINTS = 3
_MIN_DEPTH = 1e-6
# Cost of a point behind the camera: that of a clear outlier, so that a step neither gains by moving points
# behind the camera nor is blocked by a single one.
_BEHIND_CHI2 = 100.0


class PoseEstimate(NamedTuple):
    """A pose from observations.

    Attributes:
        T_cam_map: (4, 4) the pose.
        inlier: (N,) bool observations that agree with it.
        noise: standard deviation of the observations over that which they were given, at least 1.
    """

    T_cam_map: np.ndarray
    inlier: np.ndarray
    noise: float


def optimize_pose(
    T_cam_map: np.ndarray,
    points: np.ndarray,
    pixels: np.ndarray,
    inv_sigma2: np.ndarray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    max_noise: float = 1.0,
) -> PoseEstimate:
    """Refine a camera's pose on fixed map points and classify inliers and outliers.

    Levenberg-Marquardt with a Huber loss on all valid observations, then least squares on the inliers until
    they stay, three times at most. Inliers are told by their squared error against chi-square at 95%.

    Corners of a smeared image lie further off than usual, all of them. Their noise is then taken from the
    median of the squared errors after the first round, which outliers hardly move.

    Args:
        T_cam_map: (4, 4) initial pose.
        points: (N, 3) map points, frame map.
        pixels: (N, 2) their undistorted keypoints, px.
        inv_sigma2: (N,) information of each keypoint, 1/px².
        fx: focal length along x, px.
        fy: focal length along y, px.
        cx: principal point along x, px.
        cy: principal point along y, px.
        max_noise: how many times the standard deviation that ``inv_sigma2`` says the noise of this image may
            be; 1 believes ``inv_sigma2``.

    Returns:
        The refined pose and its inliers. Points behind the camera and non-finite
        observations are outliers. With fewer than three valid observations the pose is the initial one
        without inliers; if rejection leaves fewer than three, the pose is the last estimate.

    Source: Mur-Artal, Montiel, Tardós, "ORB-SLAM", 2015, section V and appendix (motion-only bundle
        adjustment); Levenberg-Marquardt with the damping of Nielsen, 1999.
    """
    pose, inlier, noise = _optimize_pose(
        np.ascontiguousarray(T_cam_map, np.float64),
        np.ascontiguousarray(points, np.float64),
        np.ascontiguousarray(pixels, np.float64),
        np.ascontiguousarray(inv_sigma2, np.float64),
        float(fx),
        float(fy),
        float(cx),
        float(cy),
        float(max_noise),
    )
    return PoseEstimate(pose, inlier, noise)


def direction_deviation(
    T_cam_map: np.ndarray, points: np.ndarray, inv_sigma2: np.ndarray, fx: float, fy: float
) -> float:
    """Standard deviation of a camera's direction, as its points determine it, rad.

    The points are taken for exact, the position as unknown too: a few points in one corner of the image, or a
    wall right ahead, leave a turn and a change of position hard to tell apart.

    Args:
        T_cam_map: (4, 4) pose.
        points: (N, 3) its map points, frame map.
        inv_sigma2: (N,) information of their keypoints, 1/px².
        fx, fy: focal lengths, px.

    Returns:
        Root of the sum of the variances about the three axes; infinity where the points leave one open.
    """
    n, H = len(points), np.zeros((6, 6))
    T_cam_map, points, inv_sigma2 = (
        np.ascontiguousarray(each, np.float64) for each in (T_cam_map, points, inv_sigma2)
    )
    used, nowhere = np.ones(n, np.bool_), np.zeros((n, 2))  # where the keypoints are does not matter
    linearise(
        T_cam_map, points, nowhere, inv_sigma2, used, 0.0, float(fx), float(fy), 0.0, 0.0, H, np.zeros(6)
    )
    H += np.tril(H, -1).T
    spread, axes = np.linalg.eigh(H)
    if not spread[0] > 1e-9 * spread[-1]:
        return np.inf
    return float(np.sqrt((axes[3:] ** 2 / spread).sum()))


@njit(cache=True, nogil=True)
def _optimize_pose(T_start, points, pixels, inv_sigma2, fx, fy, cx, cy, max_noise):
    n = points.shape[0]
    T = T_start.copy()
    inlier = np.zeros(n, np.bool_)
    sound = np.zeros(n, np.bool_)
    usable = 0
    for i in range(n):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        sound[i] = np.isfinite(x + y + z + pixels[i, 0] + pixels[i, 1] + inv_sigma2[i])
        usable += sound[i]
    if usable < _MIN_POINTS or not np.isfinite(T_start.sum()):
        return T, inlier, 1.0
    variance = 1.0
    active = sound.copy()
    for round_ in range(_ROUNDS):
        huber2 = CHI2_2DOF if round_ == 0 else 0.0
        refine_pose(T, points, pixels, inv_sigma2, active, huber2, fx, fy, cx, cy)
        if round_ == 0 and max_noise > 1.0:
            variance = _relative_variance(T, points, pixels, inv_sigma2, sound, fx, fy, cx, cy, max_noise)
            inv_sigma2 = inv_sigma2 / variance
        changed = _classify(T, points, pixels, inv_sigma2, sound, fx, fy, cx, cy, inlier)
        if inlier.sum() < _MIN_POINTS:
            break
        if round_ > 0 and changed == 0:
            break
        active[:] = inlier
    orthonormalise(T)
    return T, inlier, np.sqrt(variance)


@njit(cache=True, nogil=True)
def refine_pose(T, points, pixels, inv_sigma2, active, huber2, fx, fy, cx, cy):
    """Refine the pose ``T`` (4, 4) by Levenberg-Marquardt, in place, over the ``active`` (N,) observations.

    Returns:
        Final cost: the sum of the (robust) squared errors in units of their variance.
    """
    observed = points, pixels, inv_sigma2, active, huber2, fx, fy, cx, cy
    H, gradient = np.empty((6, 6)), np.empty(6)
    cost = linearise(T, *observed, H, gradient)
    room = np.empty((6, 6)), whole_rows(np.int64(6)), np.empty(6)
    problem = T, T.copy(), observed, H, gradient, np.empty((6, 6)), np.empty(6), *room
    return minimise(is_known, _propose, accept_trial, problem, cost, _ITERATIONS, 1e-5, 1e-7)[0]


@njit(inline="always")
def _propose(problem, damping):
    T, trial, observed, H, gradient, trial_H, trial_gradient, L, rows, step = problem
    predicted = damped_step(H, gradient, damping, L, rows, step)
    if predicted == np.inf:
        return np.inf, predicted
    retract(T, step, trial)
    return linearise(trial, *observed, trial_H, trial_gradient), predicted


@njit(cache=True, nogil=True)
def linearise(T, points, pixels, inv_sigma2, active, huber2, fx, fy, cx, cy, H, gradient):
    """Cost and its Gauss-Newton model about ``T`` for a twist from the left.

    Half the cost is ``cost/2 + gradient · twist + twist · H twist / 2`` to second order.

    ``active`` (N,) bool masks the observations used, ``huber2`` is the squared threshold of the Huber loss, 0
    for least squares. Written: the lower triangle of ``H`` (6, 6), ``gradient`` (6,).
    """
    H[:] = 0.0
    gradient[:] = 0.0
    cost = 0.0
    Ju = np.zeros(6, np.float64)
    Jv = np.zeros(6, np.float64)
    for i in range(points.shape[0]):
        if not active[i]:
            continue
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        if not z > _MIN_DEPTH:
            cost += _BEHIND_CHI2
            continue
        inv_z = 1.0 / z
        x = (T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]) * inv_z
        y = (T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]) * inv_z
        eu = fx * x + cx - pixels[i, 0]
        ev = fy * y + cy - pixels[i, 1]
        weight = inv_sigma2[i]
        chi2 = weight * (eu * eu + ev * ev)
        if 0.0 < huber2 < chi2:
            scale = np.sqrt(huber2 / chi2)
            cost += 2.0 * scale * chi2 - huber2
            weight *= scale
        else:
            cost += chi2
        Ju[0], Ju[2] = fx * inv_z, -fx * x * inv_z
        Ju[3], Ju[4], Ju[5] = -fx * x * y, fx * (1.0 + x * x), -fx * y
        Jv[1], Jv[2] = fy * inv_z, -fy * y * inv_z
        Jv[3], Jv[4], Jv[5] = -fy * (1.0 + y * y), fy * x * y, fy * x
        for r in range(6):
            wu, wv = weight * Ju[r], weight * Jv[r]
            gradient[r] += wu * eu + wv * ev
            for c in range(r + 1):
                H[r, c] += wu * Ju[c] + wv * Jv[c]
    return cost


@njit(cache=True, nogil=True)
def _classify(T, points, pixels, inv_sigma2, sound, fx, fy, cx, cy, inlier):
    """Mark the observations within chi-square in ``inlier``; number of changes."""
    changed = 0
    for i in range(points.shape[0]):
        good = sound[i] and _chi2(T, points[i], pixels[i], inv_sigma2[i], fx, fy, cx, cy) <= CHI2_2DOF
        changed += good != inlier[i]
        inlier[i] = good
    return changed


@njit(cache=True, nogil=True)
def _relative_variance(T, points, pixels, inv_sigma2, sound, fx, fy, cx, cy, max_noise):
    """Variance of this image's observations over that of ``inv_sigma2``, at least 1."""
    chi2 = np.empty(points.shape[0], np.float64)
    n = 0
    for i in range(points.shape[0]):
        if sound[i]:
            chi2[n] = _chi2(T, points[i], pixels[i], inv_sigma2[i], fx, fy, cx, cy)
            n += 1
    return min(max(np.median(chi2[:n]) / _CHI2_MEDIAN, 1.0), max_noise * max_noise)


@njit(cache=True, nogil=True)
def _chi2(T, point, pixel, inv_sigma2, fx, fy, cx, cy):
    """Squared error of a point in units of its variance; infinity behind the camera."""
    px, py, pz = point[0], point[1], point[2]
    z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
    if not z > _MIN_DEPTH:
        return np.inf
    eu = fx * (T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]) / z + cx - pixel[0]
    ev = fy * (T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]) / z + cy - pixel[1]
    return inv_sigma2 * (eu * eu + ev * ev)
