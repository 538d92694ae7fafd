"""Pose of a camera from uncertain points, some of them wrong, at a noise that the frame itself tells.

Every match is right with some probability: its error is then normal, of the keypoint's noise and the point's
own covariance. Else it lies anywhere in the window in which it was found. Pose, noise and these probabilities
are found by expectation maximisation, so that no error is cut off that the noise is estimated from.

The points are as unknown as the pose. Were their errors noise alone, a step would come out short by the
share that they have in the spread of inverse depths, which is much before a wall: regression dilution. New
points would come out near, and the map would shrink. So derivatives are taken where the frame itself puts
the points.

Source: Dempster, Laird, Rubin, "Maximum likelihood from incomplete data via the EM algorithm", 1977; the
mixture with a uniform of Torr and Zisserman, "MLESAC", 2000; errors in variables of Fuller, "Measurement
error models", 1987.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from dslab.slam.optimization._cholesky import factor, solve, whole_rows
from dslab.slam.optimization._se3 import orthonormalise, retract
from dslab.slam.optimization.student import INFORMATION, density_at, weight_at

PRIOR_WORTH = 30.0
"""Residuals that the noise of the sequence is worth beside those of a frame."""
MOST_NOISE2 = 9.0
"""Variance of a frame over the sequence's that is believed: a wrong pose must not buy itself noise."""
SAME_SURFACE = 0.03
"""Correlation of the errors of two points in one cell of the image: they are of one surface. Chosen by hand;
the share of normalised errors inside their ellipsoid is to be measured before these rules are switched on."""
CELLS = 8
"""To a row of the image, of those cells."""
_RIGHT, _WRONG = 8.0, 2.0
"""What is believed of the share of right matches before any is seen: as of ten."""
_ANNEALED, _STEPS = 5, 20
_SETTLED = 1e-2
"""In standard deviations: a step less than that ends the search."""


class UncertainPose(NamedTuple):
    """A pose from matches.

    Attributes:
        T_cam_map: (4, 4) the pose.
        right: (N,) probability of every match to be right.
        noise2: variance of the keypoints over what the view says.
        covariance: (6, 6) of the pose, as a twist from the left; infinite where it is not determined.
        drawn: by how many standard deviations the pose moves without the cell of the image that tells most.
        cells: of the image in which there are right matches.
        depth: median one of those, NaN without any.
    """

    T_cam_map: np.ndarray
    right: np.ndarray
    noise2: float
    covariance: np.ndarray
    drawn: float
    cells: int
    depth: float


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
    telling: int | None = None,
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
        telling: number of the first matches, whose errors tell the noise; the variance of the others is as
            ``inv_sigma2`` says. None for all.

    Returns:
        See :class:`UncertainPose`. A pose that the matches do not determine is the initial one.
    """
    T = np.ascontiguousarray(T_cam_map, np.float64).copy()
    found = _estimate(
        T, np.ascontiguousarray(points, np.float64), np.ascontiguousarray(point_covariance, np.float64),
        np.ascontiguousarray(pixels, np.float64), np.ascontiguousarray(inv_sigma2, np.float64),
        np.ascontiguousarray(area, np.float64), float(noise2), float(spread_px2),
        np.ascontiguousarray(prior, np.float64), intrinsics, float(cell_px),
        len(points) if telling is None else telling,
    )  # fmt: skip
    return UncertainPose(T, *found)


@njit(cache=True, nogil=True, error_model="numpy")
def _estimate(
    T, points, point_covariance, pixels, inv_sigma2, area, usual2, spread_px2, prior, intrinsics, cell_px,
    telling,
):  # fmt: skip
    start, trial = T.copy(), T.copy()
    right = np.zeros(len(points))
    spread, about_this_pose = np.empty((len(points), 5)), True
    _spread_of_points(T, points, point_covariance, intrinsics, spread)
    H, L, rows = np.empty((6, 6)), np.empty((6, 6)), whole_rows(np.int64(6))
    gradient, step = np.empty(6), np.empty(6)
    moved = np.zeros(6)  # from the start, to first order
    noise2, share = usual2, _RIGHT / (_RIGHT + _WRONG)
    determined = False
    for iteration in range(_STEPS):
        extra = spread_px2 * 0.25**iteration if iteration < _ANNEALED else 0.0
        H[:] = prior
        for r in range(6):
            gradient[r] = 0.0
            for c in range(6):
                gradient[r] += prior[r, c] * moved[c]
        share, told2 = _accumulate(
            T, points, spread, pixels, inv_sigma2, area, usual2, noise2, extra, share, intrinsics, telling,
            right, H, gradient,
        )  # fmt: skip
        if extra <= noise2:
            noise2 = told2
        L[:] = H
        step[:] = -gradient
        if not factor(L, rows):
            determined = False
            break
        solve(L, rows, step)
        gain = -np.dot(step, gradient)
        retract(T, step, trial)
        T[:] = trial
        moved += step
        determined = np.isfinite(T).all()
        settled = extra <= 0.01 * noise2 and gain < _SETTLED**2
        if not determined or (settled and about_this_pose):
            break
        about_this_pose = settled or extra > noise2
        if about_this_pose:
            _spread_of_points(T, points, point_covariance, intrinsics, spread)
    if not determined:
        T[:] = start
        return np.zeros(len(points)), usual2, np.full((6, 6), np.inf), np.inf, np.int64(0), np.nan
    orthonormalise(T)
    covariance, drawn, cells, depth = _certainty(
        T, points, spread, pixels, inv_sigma2, area, noise2, share, intrinsics, telling, right, cell_px, prior
    )
    return right, noise2, covariance, drawn, cells, depth


@njit(cache=True, nogil=True, error_model="numpy")
def _accumulate(
    T, points, spread, pixels, inv_sigma2, area, usual2, noise2, extra, share, intrinsics, telling, right, H,
    gradient,
):  # fmt: skip
    """Write the probability of every match to be right, and add all to the normal equations.

    Returns:
        (share of right ones, variance of the keypoints over what the view says): as the next step takes them.
        Of every error only the keypoint's own part tells its variance; the pose takes six of them.
    """
    J, e = np.zeros((2, 6)), np.empty(2)
    n = len(points)
    total, squares, count = 0.0, PRIOR_WORTH * usual2, 0.0
    for i in range(n):
        tells = i < telling
        own = (noise2 if tells else 1.0) / inv_sigma2[i] + extra
        p, chi2, x, y, a, b, c = _judged(
            T, points[i], spread[i], pixels[i], area[i], noise2, own, share, intrinsics, J, e
        )
        right[i] = p
        total += p
        if p <= 1e-6:
            continue
        weight = p * weight_at(chi2)
        if tells:
            rest = p * (2.0 * own - own * own * (a + c))
            squares += (weight * own * own * (x * x + y * y) + rest) * inv_sigma2[i]
            count += 2.0 * p
        _add(J, x, y, a, b, c, weight, weight, H, gradient)
    told2 = squares / max(PRIOR_WORTH + count - min(6.0, count), 1.0)
    told2 = min(max(told2, usual2 / MOST_NOISE2), usual2 * MOST_NOISE2)
    return (total + _RIGHT) / (n + _RIGHT + _WRONG), told2


@njit(cache=True, nogil=True, error_model="numpy")
def _judged(T, xyz, spread, pixel, area, noise2, own, share, intrinsics, J, e):
    """Probability of a match to be right, 0 behind the camera, where ``share`` of all are; J, e are written.

    J is at the depth at which the match itself puts the point, at least half of what it was.

    Returns:
        (probability, χ², error times information (x, y), information (uu, uv, vv)).
    """
    uu, uv, vv = _linearise(T, xyz, spread, pixel, noise2, own, intrinsics, J, e)
    if uu == 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    det = uu * vv - uv * uv
    a, b, c = vv / det, -uv / det, uu / det
    x, y = a * e[0] + b * e[1], b * e[0] + c * e[1]
    chi2 = x * e[0] + y * e[1]
    z = intrinsics[0] / J[0, 0]
    nearer = z / max(z - noise2 * (spread[3] * x + spread[4] * y), 0.5 * z)
    J[0, 0], J[0, 2] = nearer * J[0, 0], nearer * J[0, 2]
    J[1, 1], J[1, 2] = nearer * J[1, 1], nearer * J[1, 2]
    likely = share * density_at(chi2, det)
    return likely / (likely + (1.0 - share) / area), chi2, x, y, a, b, c


@njit(cache=True, nogil=True, error_model="numpy")
def _linearise(T, xyz, spread, pixel, noise2, own, intrinsics, J, e):
    """Write error (2,) and Jacobian (2, 6) of a match; its covariance (uu, uv, vv), 0 behind the camera."""
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    z = T[2, 0] * xyz[0] + T[2, 1] * xyz[1] + T[2, 2] * xyz[2] + T[2, 3]
    if not z > 1e-6:
        return 0.0, 0.0, 0.0
    x = (T[0, 0] * xyz[0] + T[0, 1] * xyz[1] + T[0, 2] * xyz[2] + T[0, 3]) / z
    y = (T[1, 0] * xyz[0] + T[1, 1] * xyz[1] + T[1, 2] * xyz[2] + T[1, 3]) / z
    fu, fv = fx / z, fy / z
    e[0], e[1] = fx * x + cx - pixel[0], fy * y + cy - pixel[1]
    J[0, 0], J[0, 2] = fu, -fu * x
    J[0, 3], J[0, 4], J[0, 5] = -fx * x * y, fx * (1.0 + x * x), -fx * y
    J[1, 1], J[1, 2] = fv, -fv * y
    J[1, 3], J[1, 4], J[1, 5] = -fy * (1.0 + y * y), fy * x * y, fy * x
    return noise2 * spread[0] + own, noise2 * spread[1], noise2 * spread[2] + own


@njit(cache=True, nogil=True, error_model="numpy")
def _spread_of_points(T, points, point_covariance, intrinsics, spread):
    """Write the covariances (N, 5) of the points in the image: uu, uv, vv, and with their depth zu, zv.

    They are 0 behind the camera.
    """
    spread[:] = 0.0
    for i in range(len(points)):
        xyz = points[i]
        z = T[2, 0] * xyz[0] + T[2, 1] * xyz[1] + T[2, 2] * xyz[2] + T[2, 3]
        if z > 1e-6:
            x = (T[0, 0] * xyz[0] + T[0, 1] * xyz[1] + T[0, 2] * xyz[2] + T[0, 3]) / z
            y = (T[1, 0] * xyz[0] + T[1, 1] * xyz[1] + T[1, 2] * xyz[2] + T[1, 3]) / z
            fu, fv, p = intrinsics[0] / z, intrinsics[1] / z, point_covariance[i]
            spread[i, :3] = of_point(T, x, y, fu, fv, p)
            zx = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2]
            zy = T[2, 0] * p[1] + T[2, 1] * p[3] + T[2, 2] * p[4]
            zz = T[2, 0] * p[2] + T[2, 1] * p[4] + T[2, 2] * p[5]
            for r, f, q in ((0, fu, x), (1, fv, y)):
                along = zx * (T[r, 0] - q * T[2, 0]) + zy * (T[r, 1] - q * T[2, 1])
                spread[i, 3 + r] = f * (along + zz * (T[r, 2] - q * T[2, 2]))


@njit(cache=True, nogil=True, error_model="numpy")
def of_point(T, x, y, fu, fv, p):
    """Covariance (uu, uv, vv) in the image of a point's (6,), seen at (x, y) for unit depth; fu is fx / z."""
    a0, a1, a2 = fu * (T[0, 0] - x * T[2, 0]), fu * (T[0, 1] - x * T[2, 1]), fu * (T[0, 2] - x * T[2, 2])
    b0, b1, b2 = fv * (T[1, 0] - y * T[2, 0]), fv * (T[1, 1] - y * T[2, 1]), fv * (T[1, 2] - y * T[2, 2])
    c0 = p[0] * a0 + p[1] * a1 + p[2] * a2
    c1 = p[1] * a0 + p[3] * a1 + p[4] * a2
    c2 = p[2] * a0 + p[4] * a1 + p[5] * a2
    d0 = p[0] * b0 + p[1] * b1 + p[2] * b2
    d1 = p[1] * b0 + p[3] * b1 + p[4] * b2
    d2 = p[2] * b0 + p[4] * b1 + p[5] * b2
    return a0 * c0 + a1 * c1 + a2 * c2, b0 * c0 + b1 * c1 + b2 * c2, b0 * d0 + b1 * d1 + b2 * d2


@njit(cache=True, nogil=True, error_model="numpy")
def _add(J, x, y, a, b, c, pull, worth, H, gradient):
    """Add a match to the normal equations: its gradient ``pull`` times, its information ``worth`` times.

    Args:
        J: (2, 6) Jacobian.
        x, y: its error times the information.
        a, b, c: information uu, uv, vv.
        pull, worth: see there.
        H: (6, 6) of which the lower triangle is written.
        gradient: (6,).
    """
    a, b, c = worth * a, worth * b, worth * c
    for r in range(6):
        gradient[r] += pull * (J[0, r] * x + J[1, r] * y)
        u, v = a * J[0, r] + b * J[1, r], b * J[0, r] + c * J[1, r]
        for k in range(r + 1):
            H[r, k] += u * J[0, k] + v * J[1, k]


@njit(cache=True, nogil=True, error_model="numpy")
def _certainty(
    T, points, spread, pixels, inv_sigma2, area, noise2, share, intrinsics, telling, right, cell_px, prior
):
    """Covariance (6, 6) of the pose, by how much a cell draws it, cells with matches, median depth.

    The probabilities to be right are written once more. The points of a cell are of one surface, so that
    their errors go together: n of them are worth n / (1 + (n - 1) ρ).
    """
    n = len(points)
    J, e = np.zeros((2, 6)), np.empty(2)
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
    depths, seen = np.empty(n), 0
    H, gradient = np.zeros((most + 1, 6, 6)), np.zeros((most + 1, 6))
    for i in range(n):
        own = (noise2 if i < telling else 1.0) / inv_sigma2[i]
        right[i], chi2, x, y, a, b, c = _judged(
            T, points[i], spread[i], pixels[i], area[i], noise2, own, share, intrinsics, J, e
        )
        if right[i] > 0.5:
            xyz = points[i]
            depths[seen] = T[2, 0] * xyz[0] + T[2, 1] * xyz[1] + T[2, 2] * xyz[2] + T[2, 3]
            seen += 1
        if right[i] > 1e-6:
            k = cell[i]
            count[k] += right[i]
            pull, worth = right[i] * weight_at(chi2), right[i] * INFORMATION
            _add(J, x, y, a, b, c, pull, worth, H[k], gradient[k])
    depth = np.median(depths[:seen]) if seen else np.nan
    most_telling, cells = 0, (count >= 0.5).sum()
    whole, slope = prior.copy(), np.zeros(6)
    for k in range(most + 1):
        shared = 1.0 + max(count[k] - 1.0, 0.0) * SAME_SURFACE
        H[k] /= shared
        gradient[k] /= shared
        whole += H[k]
        slope += gradient[k]
        if np.trace(H[k]) > np.trace(H[most_telling]):
            most_telling = k
    covariance = np.full((6, 6), np.inf)
    L, rows, column = whole.copy(), whole_rows(np.int64(6)), np.empty(6)
    if not factor(L, rows):
        return covariance, np.inf, cells, depth
    for c in range(6):
        column[:] = 0.0
        column[c] = 1.0
        solve(L, rows, column)
        covariance[:, c] = column
    covariance = 0.5 * (covariance + covariance.T)
    L[:] = whole - H[most_telling]
    if not factor(L, rows):
        return covariance, np.inf, cells, depth
    pull = gradient[most_telling] - slope
    column[:] = pull
    solve(L, rows, column)
    return covariance, np.sqrt(max(np.dot(column, pull), 0.0)), cells, depth
