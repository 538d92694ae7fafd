"""Kernels of bundle adjustment with coefficients of lens and shutter that all cameras share.

Names as in the bundle adjustment kernels; ``k`` (5,) the coefficients k1, k2, p1, p2 of the lens and the time
in which a rolling shutter reads the image, s; ``drift`` (M, 2) how far each observation is moved per second
of it, px/s. ``D`` (5, 5), ``B_c`` (F, 6, 5), ``B_p`` (P, 3, 5) are the blocks of the coefficients with
themselves, the cameras and the points.
"""

import numpy as np
from numba import njit

from dslab.slam.optimization._ba_kernels import MIN_DEPTH
from dslab.slam.optimization._cholesky import factor, solve
from dslab.slam.optimization._schur import back_substitute, eliminate_points, predicted_gain, skyline
from dslab.slam.optimization._se3 import retract
from dslab.slam.optimization.least_squares import minimise

_BEHIND_CHI2 = 1e4
_N = 5  # coefficients
_LEAST_DETERMINANT = 1e-16  # of their information, over the product of its diagonal


@njit(cache=True, nogil=True, inline="always")
def distorted(x, y, k):
    """Where the lens shows the ideal image point (x, y), in units of the focal length.

    Source: Brown, "Decentering Distortion of Lenses", 1966.
    """
    r2 = x * x + y * y
    stretch = 1.0 + r2 * (k[0] + r2 * k[1])
    return (
        x * stretch + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
        y * stretch + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y,
    )


@njit(cache=True, nogil=True)
def cost(T, points, start, camera, pixels, weights, drift, intrinsics, k, huber2):
    """Sum of the (Huber) squared errors over the points with two observations or more."""
    total = 0.0
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    for p in range(points.shape[0]):
        if start[p + 1] - start[p] < 2:
            continue
        px, py, pz = points[p, 0], points[p, 1], points[p, 2]
        for i in range(start[p], start[p + 1]):
            pose = T[camera[i]]
            z = pose[2, 0] * px + pose[2, 1] * py + pose[2, 2] * pz + pose[2, 3]
            chi2 = _BEHIND_CHI2
            if z > MIN_DEPTH:
                x = (pose[0, 0] * px + pose[0, 1] * py + pose[0, 2] * pz + pose[0, 3]) / z
                y = (pose[1, 0] * px + pose[1, 1] * py + pose[1, 2] * pz + pose[1, 3]) / z
                u, v = distorted(x, y, k)
                eu = fx * u + cx + k[4] * drift[i, 0] - pixels[i, 0]
                ev = fy * v + cy + k[4] * drift[i, 1] - pixels[i, 1]
                chi2 = weights[i] * (eu * eu + ev * ev)
            total += 2.0 * np.sqrt(huber2 * chi2) - huber2 if chi2 > huber2 else chi2
    return total


@njit(cache=True, nogil=True)
def linearise(
    T, points, start, camera, pixels, weights, drift, intrinsics, k, huber2, slot,
    U, V, W, gradient_c, gradient_p, D, gradient_k, B_c, B_p,
):  # fmt: skip
    """Compute the Gauss-Newton model of half the cost, in blocks."""
    U[:], V[:], W[:], D[:], B_c[:], B_p[:] = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    gradient_c[:], gradient_p[:], gradient_k[:] = 0.0, 0.0, 0.0
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    J = np.zeros((2, 6))  # of the pixel, by the camera's twist
    A = np.zeros((2, 3))  # by the point
    L = np.zeros((2, _N))  # by the coefficients
    C = np.zeros((2, 6))
    e = np.zeros(2)
    for p in range(points.shape[0]):
        if start[p + 1] - start[p] < 2:
            continue
        px, py, pz = points[p, 0], points[p, 1], points[p, 2]
        for i in range(start[p], start[p + 1]):
            f = slot[camera[i]]
            pose = T[camera[i]]
            z = pose[2, 0] * px + pose[2, 1] * py + pose[2, 2] * pz + pose[2, 3]
            if not z > MIN_DEPTH:
                continue
            inv_z = 1.0 / z
            x = (pose[0, 0] * px + pose[0, 1] * py + pose[0, 2] * pz + pose[0, 3]) * inv_z
            y = (pose[1, 0] * px + pose[1, 1] * py + pose[1, 2] * pz + pose[1, 3]) * inv_z
            r2 = x * x + y * y
            stretch, slope = 1.0 + r2 * (k[0] + r2 * k[1]), 2.0 * (k[0] + 2.0 * r2 * k[1])
            u, v = distorted(x, y, k)
            e[0] = fx * u + cx + k[4] * drift[i, 0] - pixels[i, 0]
            e[1] = fy * v + cy + k[4] * drift[i, 1] - pixels[i, 1]
            weight = weights[i]
            chi2 = weight * (e[0] * e[0] + e[1] * e[1])
            if chi2 > huber2:
                weight *= np.sqrt(huber2 / chi2)
            # Ideal image coordinates by the twist, then distorted pixels by the ideal coordinates.
            C[0, 0], C[0, 2] = inv_z, -x * inv_z
            C[0, 3], C[0, 4], C[0, 5] = -x * y, 1.0 + x * x, -y
            C[1, 1], C[1, 2] = inv_z, -y * inv_z
            C[1, 3], C[1, 4], C[1, 5] = -(1.0 + y * y), x * y, x
            across = x * y * slope + 2.0 * (k[2] * x + k[3] * y)
            uu, uv = fx * (stretch + x * x * slope + 2.0 * k[2] * y + 6.0 * k[3] * x), fx * across
            vu, vv = fy * across, fy * (stretch + y * y * slope + 6.0 * k[2] * y + 2.0 * k[3] * x)
            for c in range(6):
                J[0, c], J[1, c] = uu * C[0, c] + uv * C[1, c], vu * C[0, c] + vv * C[1, c]
            for c in range(3):
                ax, ay = inv_z * (pose[0, c] - x * pose[2, c]), inv_z * (pose[1, c] - y * pose[2, c])
                A[0, c], A[1, c] = uu * ax + uv * ay, vu * ax + vv * ay
            L[0, 0], L[0, 1] = fx * x * r2, fx * x * r2 * r2
            L[1, 0], L[1, 1] = fy * y * r2, fy * y * r2 * r2
            L[0, 2], L[0, 3] = fx * 2.0 * x * y, fx * (r2 + 2.0 * x * x)
            L[1, 2], L[1, 3] = fy * (r2 + 2.0 * y * y), fy * 2.0 * x * y
            L[0, 4], L[1, 4] = drift[i, 0], drift[i, 1]
            for d in range(2):
                for r in range(3):
                    gradient_p[p, r] += weight * A[d, r] * e[d]
                    for c in range(r + 1):
                        V[p, r, c] += weight * A[d, r] * A[d, c]
                    for c in range(_N):
                        B_p[p, r, c] += weight * A[d, r] * L[d, c]
                for r in range(_N):
                    gradient_k[r] += weight * L[d, r] * e[d]
                    for c in range(_N):
                        D[r, c] += weight * L[d, r] * L[d, c]
                if f < 0:
                    continue
                for r in range(6):
                    gradient_c[f, r] += weight * J[d, r] * e[d]
                    for c in range(r + 1):
                        U[f, r, c] += weight * J[d, r] * J[d, c]
                    for c in range(3):
                        W[i, r, c] += weight * J[d, r] * A[d, c]
                    for c in range(_N):
                        B_c[f, r, c] += weight * J[d, r] * L[d, c]


@njit(cache=True, nogil=True)
def eliminate_lens(
    S, first, W, V_inv, held, start, camera, slot, D, B_c, B_p, gradient_k, gradient_p, reduced
):
    """Eliminate points and cameras from the rows of the coefficients.

    Args:
        S: Cholesky factor of the reduced camera system; ``reduced`` (6 F,) its right-hand side, which becomes
            its solution.

    Returns:
        information (5, 5), right-hand side (5,), and (6 F, 5) steps of the cameras per unit of each.
    """
    n = len(reduced)
    information, right = D.copy(), -gradient_k
    B = np.zeros((n, _N))
    for f in range(n // 6):
        B[6 * f : 6 * f + 6] = B_c[f]
    for p in range(start.shape[0] - 1):
        if held[p]:
            continue
        Y = V_inv[p] @ B_p[p]
        information -= B_p[p].T @ Y
        right += Y.T @ gradient_p[p]
        for i in range(start[p], start[p + 1]):
            f = slot[camera[i]]
            if f >= 0:
                B[6 * f : 6 * f + 6] -= W[i] @ Y
    steps = np.empty((n, _N))
    for c in range(_N):
        column = B[:, c].copy()
        solve(S, first, column)
        steps[:, c] = column
    solve(S, first, reduced)
    information -= B.T.copy() @ steps
    right -= B.T.copy() @ reduced
    return information, right, steps


@njit(cache=True, nogil=True)
def spread_of_scores(
    T, points, start, camera, pixels, weights, drift, intrinsics, k, huber2, slot, V_inv, held, steps
):
    """(5, 5) sum over the points of the outer product of each one's pull on the coefficients.

    ``steps`` (6 F, 5) as returned by :func:`eliminate_lens`.
    """
    most = 0
    for p in range(len(points)):
        most = max(most, start[p + 1] - start[p])
    U, V, W = np.empty((most, 6, 6)), np.empty((1, 3, 3)), np.empty((most, 6, 3))
    gradient_c, gradient_p, gradient_k = np.empty((most, 6)), np.empty((1, 3)), np.empty(_N)
    D, B_c, B_p = np.empty((_N, _N)), np.empty((most, 6, _N)), np.empty((1, 3, _N))
    spread, own = np.zeros((_N, _N)), np.zeros(2, np.int64)
    views, own_T = np.arange(most).astype(camera.dtype), np.empty((most, 4, 4))
    own_slot = np.empty(most, np.int64)
    for p in range(len(points)):
        if held[p]:
            continue
        a, n = start[p], start[p + 1] - start[p]
        own[1] = n
        for i in range(n):
            own_T[i] = T[camera[a + i]]
            own_slot[i] = i if slot[camera[a + i]] >= 0 else -1
        linearise(
            own_T[:n], points[p : p + 1], own, views[:n], pixels[a : a + n], weights[a : a + n],
            drift[a : a + n], intrinsics, k, huber2, own_slot[:n], U[:n], V, W[:n], gradient_c[:n],
            gradient_p, D, gradient_k, B_c[:n], B_p,
        )  # fmt: skip
        pull, coupling = gradient_k.copy(), B_p[0].copy()
        for i in range(n):
            f = slot[camera[a + i]]
            if f >= 0:
                step = steps[6 * f : 6 * f + 6]
                coupling -= W[i].T.copy() @ step
                pull -= step.T.copy() @ gradient_c[i]
        pull -= (V_inv[p] @ coupling).T.copy() @ gradient_p[0]
        spread += np.outer(pull, pull)
    return spread


@njit(cache=True, nogil=True)
def adjust(
    T, points, start, camera, pixels, weights, drift, intrinsics, k, slot, n_free, iterations, huber2, prior
):
    """Minimise the cost over ``T``, ``points`` and ``k`` by Levenberg-Marquardt, in place.

    Args:
        prior: (5, 5) information on ``k`` about 0 beside that of the observations.

    Returns:
        information (5, 5) of the observations on ``k`` once poses and points are eliminated, and the spread
        (5, 5) of the points' pulls on it; both 0 where there is no solution.
    """
    n_points, m = points.shape[0], camera.shape[0]
    model = (
        np.empty((n_free, 6, 6)), np.empty((n_points, 3, 3)), np.empty((m, 6, 3)), np.empty((n_free, 6)),
        np.empty((n_points, 3)), np.empty((_N, _N)), np.empty(_N), np.empty((n_free, 6, _N)),
        np.empty((n_points, 3, _N)),
    )  # fmt: skip
    room = (
        skyline(start, camera, slot, n_free), np.zeros((n_points, 3, 3)), np.zeros(n_points, np.bool_),
        np.empty((6 * n_free, 6 * n_free)), np.empty(6 * n_free), np.empty((n_points, 3)),
    )  # fmt: skip
    observed = start, camera, pixels, weights, drift, intrinsics
    state, trial = (T, points, k), (T.copy(), points.copy(), k.copy())
    problem = state, trial, observed, prior, huber2, slot, model, room
    initial = _cost(state, problem)
    minimise(_linearise, _propose, _accept, problem, initial, iterations, 1e-6, 1e-5)
    linearise(T, points, *observed, k, huber2, slot, *model)
    if not _eliminate(problem, 1e-9):
        return np.zeros((_N, _N)), np.zeros((_N, _N))
    first, V_inv, held, S, step_c, _ = room
    _, _, W, _, gradient_p, D, gradient_k, B_c, B_p = model
    information, _, steps = eliminate_lens(
        S, first, W, V_inv, held, start, camera, slot, D, B_c, B_p, gradient_k, gradient_p, step_c
    )
    return information, spread_of_scores(T, points, *observed, k, huber2, slot, V_inv, held, steps)


@njit(inline="always")
def _cost(state, problem):
    """Cost of a state, with that of the prior."""
    T, points, k = state
    _, _, observed, prior, huber2, _, _, _ = problem
    return cost(T, points, *observed, k, huber2) + k @ prior @ k


@njit(inline="always")
def _linearise(problem):
    (T, points, k), _, observed, prior, huber2, slot, model, _ = problem
    linearise(T, points, *observed, k, huber2, slot, *model)
    _, _, _, _, _, D, gradient_k, _, _ = model
    D += prior
    gradient_k += prior @ k


@njit(inline="always")
def _eliminate(problem, damping):
    """Eliminate the points and factor what is left of the poses; False if that is singular."""
    _, _, observed, _, _, slot, model, room = problem
    start, camera, _, _, _, _ = observed
    U, V, W, gradient_c, gradient_p, _, _, _, _ = model
    first, V_inv, held, S, step_c, _ = room
    eliminate_points(
        U, V, W, gradient_c, gradient_p, start, camera, slot, damping, first, V_inv, held, S, step_c
    )
    return factor(S, first)


@njit(inline="always")
def _propose(problem, damping):
    (T, points, k), trial, observed, _, _, slot, model, room = problem
    start, camera, _, _, _, _ = observed
    U, V, W, gradient_c, gradient_p, D, gradient_k, B_c, B_p = model
    first, V_inv, held, S, step_c, step_p = room
    if not _eliminate(problem, damping):
        return np.inf, np.inf
    information, right, steps = eliminate_lens(
        S, first, W, V_inv, held, start, camera, slot, D, B_c, B_p, gradient_k, gradient_p, step_c
    )
    if not np.linalg.det(information) > _LEAST_DETERMINANT * np.prod(np.diag(information)):
        return np.inf, 0.0  # no damping helps
    step_k = np.linalg.solve(information, right)
    step_c -= steps @ step_k
    pulled = np.empty_like(gradient_p)
    for p in range(len(points)):
        pulled[p] = gradient_p[p] + B_p[p] @ step_k
    back_substitute(W, pulled, start, camera, slot, V_inv, held, step_c, step_p)
    predicted = predicted_gain(U, V, gradient_c, gradient_p, damping, step_c, step_p, held)
    predicted -= step_k @ gradient_k
    trial_T, trial_points, trial_k = trial
    for c in range(T.shape[0]):
        if slot[c] >= 0:
            retract(T[c], step_c[6 * slot[c] : 6 * slot[c] + 6], trial_T[c])
    trial_points[:], trial_k[:] = points + step_p, k + step_k
    return _cost(trial, problem), predicted


@njit(inline="always")
def _accept(problem):
    (T, points, k), (trial_T, trial_points, trial_k), _, _, _, _, _, _ = problem
    T[:], points[:], k[:] = trial_T, trial_points, trial_k
    return False
