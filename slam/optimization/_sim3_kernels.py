"""Kernels of Sim(3) estimation: Horn's closed form, RANSAC, Levenberg-Marquardt.

Names: ``points_1``, ``points_2`` (N, 3) pairs, each in its own camera's frame; ``pixels_*`` (N, 2);
``weights_*`` (N,) 1/px²; ``intrinsics`` (4,) fx, fy, cx, cy; ``S`` (4, 4) = [s R | t], 2 to 1.
"""

import numpy as np
from numba import njit

from dslab.slam.optimization._cholesky import whole_rows
from dslab.slam.optimization._se3 import so3_exp
from dslab.slam.optimization.least_squares import accept_trial, damped_step, is_known, minimise

_MIN_DEPTH = 1e-6
# Cost of a point behind the camera; see the pose optimisation.
_BEHIND_CHI2 = 1e4


@njit(cache=True, nogil=True)
def horn(a, b, rows, fixed_scale):
    """Least-squares similarity from ``b`` to ``a`` over some rows, by the quaternion of Horn, 1987.

    Returns:
        True if the rows determine it, s, R (3, 3), t (3,).
    """
    n = rows.shape[0]
    R, t = np.eye(3), np.zeros(3, np.float64)
    if n < 3:
        return False, 1.0, R, t
    mean_a, mean_b = np.zeros(3, np.float64), np.zeros(3, np.float64)
    for i in rows:
        mean_a += a[i]
        mean_b += b[i]
    mean_a /= n
    mean_b /= n
    M = np.zeros((3, 3), np.float64)
    spread_b = 0.0
    for i in rows:
        for r in range(3):
            spread_b += (b[i, r] - mean_b[r]) ** 2
            for c in range(3):
                M[r, c] += (b[i, r] - mean_b[r]) * (a[i, c] - mean_a[c])
    if not (np.isfinite(M.sum()) and spread_b > 0.0):
        return False, 1.0, R, t
    values, vectors = np.linalg.eigh(_horn_matrix(M))
    # Collinear points leave the rotation about their line undetermined: the largest eigenvalue is then
    # double.
    if not values[3] - values[2] > 1e-9 * values[3]:
        return False, 1.0, R, t
    _rotation_of(vectors[:, 3], R)
    s = 1.0
    if not fixed_scale:
        # sum a · R b over sum |b|², section 2C.
        s = 0.0
        for r in range(3):
            for c in range(3):
                s += R[r, c] * M[c, r]
        s /= spread_b
        if not s > 0.0:
            return False, 1.0, R, t
    for r in range(3):
        t[r] = mean_a[r] - s * (R[r, 0] * mean_b[0] + R[r, 1] * mean_b[1] + R[r, 2] * mean_b[2])
    return True, s, R, t


@njit(cache=True, nogil=True)
def _horn_matrix(M):
    """Symmetric 4x4 matrix whose largest eigenvector is the quaternion (w, x, y, z); section 4A."""
    N = np.empty((4, 4), np.float64)
    N[0, 0] = M[0, 0] + M[1, 1] + M[2, 2]
    N[1, 1] = M[0, 0] - M[1, 1] - M[2, 2]
    N[2, 2] = -M[0, 0] + M[1, 1] - M[2, 2]
    N[3, 3] = -M[0, 0] - M[1, 1] + M[2, 2]
    N[1, 0] = M[1, 2] - M[2, 1]
    N[2, 0] = M[2, 0] - M[0, 2]
    N[3, 0] = M[0, 1] - M[1, 0]
    N[2, 1] = M[0, 1] + M[1, 0]
    N[3, 1] = M[2, 0] + M[0, 2]
    N[3, 2] = M[1, 2] + M[2, 1]
    for r in range(4):
        for c in range(r):
            N[c, r] = N[r, c]
    return N


@njit(cache=True, nogil=True)
def _rotation_of(q, R):
    """Write the rotation of a unit quaternion (w, x, y, z) to ``R``."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@njit(cache=True, nogil=True)
def _squared_error(A, p, pixel, weight, intrinsics):
    """Squared error, in units of its variance, of ``A`` (4, 4) times ``p`` seen at ``pixel``."""
    z = A[2, 0] * p[0] + A[2, 1] * p[1] + A[2, 2] * p[2] + A[2, 3]
    if not z > _MIN_DEPTH:
        return np.inf
    x = A[0, 0] * p[0] + A[0, 1] * p[1] + A[0, 2] * p[2] + A[0, 3]
    y = A[1, 0] * p[0] + A[1, 1] * p[1] + A[1, 2] * p[2] + A[1, 3]
    eu = intrinsics[0] * x / z + intrinsics[2] - pixel[0]
    ev = intrinsics[1] * y / z + intrinsics[3] - pixel[1]
    return weight * (eu * eu + ev * ev)


@njit(cache=True, nogil=True)
def _both_ways(s, R, t):
    """``S`` and its inverse, (4, 4)."""
    S, inverse = np.eye(4), np.eye(4)
    for r in range(3):
        S[r, 3] = t[r]
        inverse[r, 3] = -(R[0, r] * t[0] + R[1, r] * t[1] + R[2, r] * t[2]) / s
        for c in range(3):
            S[r, c] = s * R[r, c]
            inverse[r, c] = R[c, r] / s
    return S, inverse


@njit(cache=True, nogil=True)
def agreeing(points_1, points_2, pixels_1, pixels_2, weights_1, weights_2, intrinsics, chi2, s, R, t):
    """Mask (N,) bool of the pairs whose points reproject within ``chi2`` in both cameras."""
    S_1_2, S_2_1 = _both_ways(s, R, t)
    inliers = np.zeros(points_1.shape[0], np.bool_)
    for i in range(points_1.shape[0]):
        inliers[i] = (
            _squared_error(S_1_2, points_2[i], pixels_1[i], weights_1[i], intrinsics) <= chi2
            and _squared_error(S_2_1, points_1[i], pixels_2[i], weights_2[i], intrinsics) <= chi2
        )
    return inliers


@njit(cache=True, nogil=True)
def ransac(
    points_1,
    points_2,
    pixels_1,
    pixels_2,
    weights_1,
    weights_2,
    intrinsics,
    chi2,
    triplets,
    fixed_scale,
    confidence,
):
    """Find the similarity of a triplet (K, 3) with most inliers, stopping early if unlikely to improve.

    Returns:
        True if any triplet gave one, s, R, t, inliers (N,).
    """
    n = points_1.shape[0]
    best_s, best_R, best_t = 1.0, np.eye(3), np.zeros(3, np.float64)
    best = np.zeros(n, np.bool_)
    best_count, needed = 0, triplets.shape[0]
    for k in range(triplets.shape[0]):
        if k >= needed:
            break
        found, s, R, t = horn(points_1, points_2, triplets[k], fixed_scale)
        if not found:
            continue
        inliers = agreeing(
            points_1, points_2, pixels_1, pixels_2, weights_1, weights_2, intrinsics, chi2, s, R, t
        )
        count = inliers.sum()
        if count <= best_count:
            continue
        best_count, best_s, best_R, best_t, best = count, s, R, t, inliers
        miss = 1.0 - (count / n) ** 3
        if miss < 1e-12:
            break
        if miss == 1.0:
            continue
        needed = min(needed, int(np.ceil(np.log(1.0 - confidence) / np.log(miss))))
    return best_count > 0, best_s, best_R, best_t, best


@njit(cache=True, nogil=True)
def retract_sim3(S, twist, out):
    """Write ``exp(w) e^σ S`` shifted by ``v`` to ``out`` for the twist (v, w, σ) (7,).

    A step changes the scale by at most a factor of e, so that a bad one can be corrected later.
    """
    R = so3_exp(twist[3], twist[4], twist[5])
    growth = np.exp(min(max(twist[6], -1.0), 1.0))
    for r in range(3):
        for c in range(4):
            out[r, c] = growth * (R[r, 0] * S[0, c] + R[r, 1] * S[1, c] + R[r, 2] * S[2, c])
        out[r, 3] += twist[r]


@njit(cache=True, nogil=True)
def _add_residual(x, y, z, D, pixel, weight, intrinsics, huber2, H, gradient):
    """Add one observation of the point (x, y, z) with derivative ``D`` (3, 7); its (robust) cost."""
    if not z > _MIN_DEPTH:
        return _BEHIND_CHI2
    fx, fy = intrinsics[0], intrinsics[1]
    u, v = x / z, y / z
    eu = fx * u + intrinsics[2] - pixel[0]
    ev = fy * v + intrinsics[3] - pixel[1]
    cost = weight * (eu * eu + ev * ev)
    if 0.0 < huber2 < cost:
        scale = np.sqrt(huber2 / cost)
        cost = 2.0 * scale * cost - huber2
        weight *= scale
    Ju, Jv = np.empty(7, np.float64), np.empty(7, np.float64)
    for k in range(7):
        Ju[k] = fx * (D[0, k] - u * D[2, k]) / z
        Jv[k] = fy * (D[1, k] - v * D[2, k]) / z
    for r in range(7):
        gradient[r] += weight * (Ju[r] * eu + Jv[r] * ev)
        for c in range(r + 1):
            H[r, c] += weight * (Ju[r] * Ju[c] + Jv[r] * Jv[c])
    return cost


@njit(cache=True, nogil=True)
def _add_depth(z, z_own, D, weight, huber2, H, gradient):
    """Add the logarithm of two depths' ratio, ``z`` with derivative ``D`` (3, 7); its (robust) cost."""
    if weight == 0.0 or not (z > _MIN_DEPTH and z_own > _MIN_DEPTH):
        return 0.0
    e = np.log(z / z_own)
    cost = weight * e * e
    if 0.0 < huber2 < cost:
        scale = np.sqrt(huber2 / cost)
        cost = 2.0 * scale * cost - huber2
        weight *= scale
    for r in range(7):
        gradient[r] += weight * e * D[2, r] / z
        for c in range(r + 1):
            H[r, c] += weight * D[2, r] * D[2, c] / (z * z)
    return cost


@njit(cache=True, nogil=True)
def _twist_derivative(x, y, z, D):
    """Write the derivative (3, 7) of a point (x, y, z) of frame 1 by a twist from the left."""
    D[:] = 0.0
    D[0, 0] = D[1, 1] = D[2, 2] = 1.0
    D[0, 4], D[0, 5] = z, -y
    D[1, 3], D[1, 5] = -z, x
    D[2, 3], D[2, 4] = y, -x
    D[0, 6], D[1, 6], D[2, 6] = x, y, z


@njit(cache=True, nogil=True)
def linearise(
    S, points_1, points_2, pixels_1, pixels_2, weights_1, weights_2, intrinsics, active, depth_weight,
    huber2, fixed_scale, H, gradient,
):  # fmt: skip
    """Cost of reprojection errors and depths, and its Gauss-Newton model for a left twist.

    ``depth_weight`` is the information of the logarithm of a depth in camera 1; 0 leaves depths out.
    Written: the lower triangle of ``H`` (7, 7) and ``gradient`` (7,).
    """
    H[:] = 0.0
    gradient[:] = 0.0
    cost = 0.0
    s2 = S[0, 0] ** 2 + S[1, 0] ** 2 + S[2, 0] ** 2
    # The inverse of s R is its transpose over s².
    inverse = S[:3, :3].T / s2
    D, D_2 = np.empty((3, 7), np.float64), np.empty((3, 7), np.float64)
    for i in range(points_1.shape[0]):
        if not active[i]:
            continue
        p = points_2[i]
        x = S[0, 0] * p[0] + S[0, 1] * p[1] + S[0, 2] * p[2] + S[0, 3]
        y = S[1, 0] * p[0] + S[1, 1] * p[1] + S[1, 2] * p[2] + S[1, 3]
        z = S[2, 0] * p[0] + S[2, 1] * p[1] + S[2, 2] * p[2] + S[2, 3]
        _twist_derivative(x, y, z, D)
        cost += _add_residual(x, y, z, D, pixels_1[i], weights_1[i], intrinsics, huber2, H, gradient)
        q = points_1[i]
        cost += _add_depth(z, q[2], D, depth_weight, huber2, H, gradient)
        dx, dy, dz = q[0] - S[0, 3], q[1] - S[1, 3], q[2] - S[2, 3]
        x = inverse[0, 0] * dx + inverse[0, 1] * dy + inverse[0, 2] * dz
        y = inverse[1, 0] * dx + inverse[1, 1] * dy + inverse[1, 2] * dz
        z = inverse[2, 0] * dx + inverse[2, 1] * dy + inverse[2, 2] * dz
        _twist_derivative(q[0], q[1], q[2], D)
        for r in range(3):
            for k in range(7):
                D_2[r, k] = -(inverse[r, 0] * D[0, k] + inverse[r, 1] * D[1, k] + inverse[r, 2] * D[2, k])
        cost += _add_residual(x, y, z, D_2, pixels_2[i], weights_2[i], intrinsics, huber2, H, gradient)
    if fixed_scale:
        H[6, :6], gradient[6], H[6, 6] = 0.0, 0.0, 1.0
    return cost


@njit(cache=True, nogil=True)
def refine(
    S, points_1, points_2, pixels_1, pixels_2, weights_1, weights_2, intrinsics, active, depth_weight,
    huber2, fixed_scale, iterations,
):  # fmt: skip
    """Refine ``S`` by Levenberg-Marquardt, in place, over the ``active`` (N,) pairs; the final cost."""
    pairs = (
        points_1, points_2, pixels_1, pixels_2, weights_1, weights_2, intrinsics, active, depth_weight,
        huber2, fixed_scale,
    )  # fmt: skip
    H, gradient = np.empty((7, 7)), np.empty(7)
    cost = linearise(S, *pairs, H, gradient)
    room = np.empty((7, 7)), whole_rows(np.int64(7)), np.empty(7)
    problem = S, S.copy(), pairs, H, gradient, np.empty((7, 7)), np.empty(7), *room
    return minimise(is_known, _propose, accept_trial, problem, cost, iterations, 1e-5, 1e-8)[0]


@njit(inline="always")
def _propose(problem, damping):
    S, trial, pairs, H, gradient, trial_H, trial_gradient, L, rows, step = problem
    predicted = damped_step(H, gradient, damping, L, rows, step)
    if predicted == np.inf:
        return np.inf, predicted
    retract_sim3(S, step, trial)
    return linearise(trial, *pairs, trial_H, trial_gradient), predicted
