"""Pose of a camera from uncertain points, some of them wrong, at a noise that the frame itself tells.

Every match is right with some probability: its error is then normal, of the keypoint's noise and the point's
own covariance. Else it lies anywhere in the window in which it was found. Pose, noise and these probabilities
are found by expectation maximisation, so that no error is cut off that the noise is estimated from.

Source: Dempster, Laird, Rubin, "Maximum likelihood from incomplete data via the EM algorithm", 1977; the
mixture with a uniform of Torr and Zisserman, "MLESAC", 2000.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from dslab.slam.optimization._cholesky import factor, solve, whole_rows
from dslab.slam.optimization._se3 import orthonormalise, retract

PRIOR_WORTH = 30.0
"""Residuals that the noise of the sequence is worth beside those of a frame."""
MOST_NOISE2 = 9.0
"""Variance of a frame over the sequence's that is believed: a wrong pose must not buy itself noise."""
SAME_SURFACE = 0.03
"""Correlation of the errors of two points in one cell of the image: they are of one surface. Chosen by hand;
the share of normalised errors inside their ellipsoid is to be measured before these rules are switched on."""
CELLS = 8
"""To a row of the image, of those cells."""
TAILS = 4.0
"""Degrees of freedom of Student's t that the errors of right matches follow."""
INFORMATION = (TAILS + 2.0) / (TAILS + 4.0) * TAILS / (TAILS - 2.0)
"""Fisher's, of a bivariate t over that of a normal of the same variance."""
_RIGHT, _WRONG = 8.0, 2.0
"""What is believed of the share of right matches before any is seen: as of ten."""
_ANNEALED, _STEPS = 5, 12
_SETTLED = 1e-3
"""In standard deviations: a step less than that ends the search."""


class UncertainPose(NamedTuple):
    """A pose from matches.

    Attributes:
        T_cam_map: (4, 4) the pose.
        right: (N,) probability of every match to be right.
        noise2: variance of the keypoints over what the view says.
        covariance: (6, 6) of the pose, as a twist from the left; infinite where it is not determined.
        drawn: by how many standard deviations the pose moves without the cell of the image that tells most.
    """

    T_cam_map: np.ndarray
    right: np.ndarray
    noise2: float
    covariance: np.ndarray
    drawn: float


def uncertain_pose(
    T_cam_map: np.ndarray,
    points: np.ndarray,
    point_covariance: np.ndarray,
    pixels: np.ndarray,
    inv_sigma2: np.ndarray,
    area: np.ndarray,
    noise2: float,
    spread_px2: float,
    prior: np.ndarray,
    intrinsics: np.ndarray,
    cell_px: float,
) -> UncertainPose:
    """Refine a camera's pose on uncertain points.

    Args:
        T_cam_map: (4, 4) initial pose.
        points: (N, 3) map points.
        point_covariance: (N, 6) of them at the noise that the view says.
        pixels: (N, 2) undistorted keypoints, px.
        inv_sigma2: (N,) information of each keypoint at that noise, 1/px².
        area: (N,) of the window in which each was found, px².
        noise2: variance of the sequence's keypoints over what the view says.
        spread_px2: variance in the image of the error of the initial pose; where it is large, matches are
            told right from wrong step by step.
        prior: (6, 6) information of the initial pose, zeros for none.
        intrinsics: (4,) fx, fy, cx, cy, px.
        cell_px: side of the cells of the image.

    Returns:
        See :class:`UncertainPose`. A pose that the matches do not determine is the initial one.
    """
    T = np.ascontiguousarray(T_cam_map, np.float64).copy()
    found = _estimate(
        T, np.ascontiguousarray(points, np.float64), np.ascontiguousarray(point_covariance, np.float64),
        np.ascontiguousarray(pixels, np.float64), np.ascontiguousarray(inv_sigma2, np.float64),
        np.ascontiguousarray(area, np.float64), float(noise2), float(spread_px2),
        np.ascontiguousarray(prior, np.float64), intrinsics, float(cell_px),
    )  # fmt: skip
    return UncertainPose(T, *found)


@njit(cache=True, nogil=True)
def _estimate(
    T, points, point_covariance, pixels, inv_sigma2, area, usual2, spread_px2, prior, intrinsics, cell_px
):
    n = len(points)
    start = T.copy()
    right, weight = np.ones(n), np.ones(n)
    errors = np.empty((n, 2))
    S = np.empty((n, 3))
    J = np.empty((n, 2, 6))
    H, gradient, L, step = np.empty((6, 6)), np.empty(6), np.empty((6, 6)), np.empty(6)
    moved = np.zeros(6)  # from the start, to first order
    rows = whole_rows(np.int64(6))
    trial = T.copy()
    noise2, share = usual2, _RIGHT / (_RIGHT + _WRONG)
    unknown = np.full((6, 6), np.inf)
    extra = spread_px2
    determined = False
    for iteration in range(_STEPS):
        extra = spread_px2 * 0.25**iteration if iteration < _ANNEALED else 0.0
        linearise(T, points, point_covariance, pixels, inv_sigma2, noise2, extra, intrinsics, errors, S, J)
        share = _expect(errors, S, area, share, right, weight)
        if extra <= noise2:
            noise2 = _noise(errors, S, right, weight, inv_sigma2, usual2, noise2)
        H[:] = prior
        for r in range(6):
            gradient[r] = 0.0
            for c in range(6):
                gradient[r] += prior[r, c] * moved[c]
        for i in range(n):
            if right[i] > 1e-6:
                _add(J[i], errors[i], S[i], weight[i], weight[i], H, gradient)
        L[:] = H
        step[:] = -gradient
        if not factor(L, rows):
            T[:] = start
            return np.zeros(n), usual2, unknown, np.inf
        solve(L, rows, step)
        gain = -np.dot(step, gradient)
        retract(T, step, trial)
        T[:] = trial
        moved += step
        determined = np.isfinite(T).all()
        if not determined or (extra <= 0.01 * noise2 and gain < _SETTLED**2):
            break
    if not determined:
        T[:] = start
        return np.zeros(n), usual2, unknown, np.inf
    orthonormalise(T)
    linearise(T, points, point_covariance, pixels, inv_sigma2, noise2, 0.0, intrinsics, errors, S, J)
    _expect(errors, S, area, share, right, weight)
    covariance, drawn = _certainty(J, errors, S, right, weight, pixels, cell_px, prior)
    return right, noise2, covariance, drawn


@njit(cache=True, nogil=True)
def linearise(T, points, point_covariance, pixels, inv_sigma2, noise2, extra, intrinsics, errors, S, J):
    """Write errors (n, 2), their covariances (n, 3) uu, uv, vv, and Jacobians (n, 2, 6) about a pose.

    A point behind the camera has an infinite error.
    """
    fx, fy, cx, cy = intrinsics
    for i in range(len(points)):
        px, py, pz = points[i]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        if not z > 1e-6:
            errors[i] = np.inf
            S[i, 0], S[i, 1], S[i, 2] = 1.0, 0.0, 1.0
            J[i] = 0.0
            continue
        x = (T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]) / z
        y = (T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]) / z
        fu, fv = fx / z, fy / z
        errors[i, 0], errors[i, 1] = fx * x + cx - pixels[i, 0], fy * y + cy - pixels[i, 1]
        J[i, 0, 0], J[i, 0, 1], J[i, 0, 2] = fu, 0.0, -fu * x
        J[i, 0, 3], J[i, 0, 4], J[i, 0, 5] = -fx * x * y, fx * (1.0 + x * x), -fx * y
        J[i, 1, 0], J[i, 1, 1], J[i, 1, 2] = 0.0, fv, -fv * y
        J[i, 1, 3], J[i, 1, 4], J[i, 1, 5] = -fy * (1.0 + y * y), fy * x * y, fy * x
        p = point_covariance[i]
        a0, a1, a2 = fu * (T[0, 0] - x * T[2, 0]), fu * (T[0, 1] - x * T[2, 1]), fu * (T[0, 2] - x * T[2, 2])
        b0, b1, b2 = fv * (T[1, 0] - y * T[2, 0]), fv * (T[1, 1] - y * T[2, 1]), fv * (T[1, 2] - y * T[2, 2])
        c0 = p[0] * a0 + p[1] * a1 + p[2] * a2
        c1 = p[1] * a0 + p[3] * a1 + p[4] * a2
        c2 = p[2] * a0 + p[4] * a1 + p[5] * a2
        noise = noise2 / inv_sigma2[i] + extra
        S[i, 0] = noise2 * (a0 * c0 + a1 * c1 + a2 * c2) + noise
        S[i, 1] = noise2 * (b0 * c0 + b1 * c1 + b2 * c2)
        c0 = p[0] * b0 + p[1] * b1 + p[2] * b2
        c1 = p[1] * b0 + p[3] * b1 + p[4] * b2
        c2 = p[2] * b0 + p[4] * b1 + p[5] * b2
        S[i, 2] = noise2 * (b0 * c0 + b1 * c1 + b2 * c2) + noise


@njit(cache=True, nogil=True)
def _expect(errors, S, area, share, right, weight):
    """Write the probability of every match to be right, and that times its weight; the share of right ones.

    Errors of right ones are of Student's t with covariance S: those far out weigh less.
    """
    total = 0.0
    for i in range(len(errors)):
        right[i] = weight[i] = 0.0
        if np.isfinite(errors[i, 0]):
            det = S[i, 0] * S[i, 2] - S[i, 1] ** 2
            chi2 = _chi2(errors[i], S[i], det)
            likely = share * density_at(chi2, det)
            right[i] = likely / (likely + (1.0 - share) / area[i])
            weight[i] = right[i] * (TAILS + 2.0) / (TAILS - 2.0 + chi2)
        total += right[i]
    return (total + _RIGHT) / (len(errors) + _RIGHT + _WRONG)


@njit(cache=True, nogil=True)
def density_at(chi2, det):
    """Density, 1/px², of a right match's error, by its normalised square and its covariance's determinant."""
    tail = 1.0 + chi2 / (TAILS - 2.0)
    return TAILS / (TAILS - 2.0) * tail ** (-0.5 * TAILS - 1.0) / (2.0 * np.pi * np.sqrt(det))


@njit(cache=True, nogil=True)
def _chi2(e, S, det):
    return (S[2] * e[0] * e[0] - 2.0 * S[1] * e[0] * e[1] + S[0] * e[1] * e[1]) / det


@njit(cache=True, nogil=True)
def _noise(errors, S, right, weight, inv_sigma2, usual2, noise2):
    """Variance of the keypoints over what the view says, from what of the errors is theirs.

    The pose has taken six degrees of freedom of the errors.
    """
    total, count = PRIOR_WORTH * usual2, PRIOR_WORTH
    own = 0.0
    for i in range(len(errors)):
        if right[i] > 1e-6:
            det = S[i, 0] * S[i, 2] - S[i, 1] ** 2
            a, b, c = S[i, 2] / det, -S[i, 1] / det, S[i, 0] / det
            x, y = a * errors[i, 0] + b * errors[i, 1], b * errors[i, 0] + c * errors[i, 1]
            variance = noise2 / inv_sigma2[i]
            # Mean square of the keypoint's own part, given the whole error, over what the view says.
            rest = right[i] * (2.0 * variance - variance**2 * (a + c))
            total += (weight[i] * variance**2 * (x * x + y * y) + rest) * inv_sigma2[i]
            own += 2.0 * right[i]
    count += own
    left = max(count - min(6.0, own), 1.0)
    return min(max(total / left, usual2 / MOST_NOISE2), usual2 * MOST_NOISE2)


@njit(cache=True, nogil=True)
def _add(J, e, S, pull, worth, H, gradient):
    """Add a match to the normal equations, its gradient ``pull`` and its information ``worth`` times.

    ``H`` (6, 6) is whole.
    """
    det = S[0] * S[2] - S[1] * S[1]
    a, b, c = worth * S[2] / det, -worth * S[1] / det, worth * S[0] / det
    for r in range(6):
        u, v = a * J[0, r] + b * J[1, r], b * J[0, r] + c * J[1, r]
        gradient[r] += pull / worth * (u * e[0] + v * e[1])
        for k in range(r + 1):
            value = u * J[0, k] + v * J[1, k]
            H[r, k] += value
            if k < r:
                H[k, r] += value


@njit(cache=True, nogil=True)
def _certainty(J, errors, S, right, weight, pixels, cell_px, prior):
    """Covariance (6, 6) of the pose, and by how much the most telling cell of the image draws it.

    The points of a cell are of one surface, so that their errors go together: n of them are worth
    n / (1 + (n - 1) ρ).
    """
    n = len(J)
    cell = np.empty(n, np.int64)
    most = 0
    low_x, low_y = np.inf, np.inf
    for i in range(n):
        low_x, low_y = min(low_x, pixels[i, 0]), min(low_y, pixels[i, 1])
    for i in range(n):
        column = min(int((pixels[i, 0] - low_x) / cell_px), CELLS)
        cell[i] = int((pixels[i, 1] - low_y) / cell_px) * (CELLS + 1) + column
        most = max(most, cell[i])
    count = np.zeros(most + 1)
    for i in range(n):
        count[cell[i]] += right[i]
    H, gradient = np.zeros((most + 1, 6, 6)), np.zeros((most + 1, 6))
    whole, slope = prior.copy(), np.zeros(6)
    for i in range(n):
        k = cell[i]
        if right[i] > 1e-6:
            shared = 1.0 + max(count[k] - 1.0, 0.0) * SAME_SURFACE
            worth = INFORMATION * right[i] / shared
            _add(J[i], errors[i], S[i], weight[i] / shared, worth, H[k], gradient[k])
    telling = 0
    for k in range(most + 1):
        whole += H[k]
        slope += gradient[k]
        if np.trace(H[k]) > np.trace(H[telling]):
            telling = k
    covariance = np.full((6, 6), np.inf)
    L, rows, column = whole.copy(), whole_rows(np.int64(6)), np.empty(6)
    if not factor(L, rows):
        return covariance, np.inf
    for c in range(6):
        column[:] = 0.0
        column[c] = 1.0
        solve(L, rows, column)
        covariance[:, c] = column
    covariance = 0.5 * (covariance + covariance.T)
    without = whole - H[telling]
    L[:] = without
    if not factor(L, rows):
        return covariance, np.inf
    pull = gradient[telling] - slope
    column[:] = pull
    solve(L, rows, column)
    return covariance, np.sqrt(max(np.dot(column, pull), 0.0))
