"""Kernels of bundle adjustment: residuals, normal equations, Levenberg-Marquardt.

Observations are sorted by point, so that all terms of a point are processed together.

Names: ``T`` (C, 4, 4) T_cam_map; ``points`` (P, 3); ``start`` (P + 1,) first observation of each point;
``camera`` (M,), ``pixels`` (M, 2), ``weights`` (M,) observations sorted by point; ``slot`` (C,) position
of a camera among the free ones, -1 where fixed; ``intrinsics`` (4,) fx, fy, cx, cy.
"""

import numpy as np
from numba import njit

from dslab.slam.optimization._block_sums import add_outer_products
from dslab.slam.optimization._cholesky import factor, solve
from dslab.slam.optimization._schur import back_substitute, eliminate_points, predicted_gain, skyline
from dslab.slam.optimization._se3 import retract
from dslab.slam.optimization.least_squares import minimise
from dslab.slam.optimization.student import loss_at, weight_at

MIN_DEPTH = 1e-6
# Cost of an observation behind its camera: a hundred sigma, so that no step gains by moving it there.
_BEHIND_CHI2 = 1e4
_MOST_APPROACH = 0.9  # share of its inverse depth that a point may lose in one step
_ARRIVED = 1e-3
"""The last step of all free poses, squared in units of their covariance: a thirtieth of a deviation. The cost
goes on falling, as by Student's t wrong observations leave for fifty steps: they have no say in the poses. At
a tenth the steps along a wall add up (docs/notebook/base-decides.md)."""
_LITTLE_DAMPING = 1e-3
"""With more of it a step is short by its damping."""


@njit(cache=True, nogil=True, error_model="numpy")
def sort_by_point(n_points, obs_point):
    """Sort observations by point: ``start`` (P + 1,) int64 and ``order`` (M,) int64."""
    start = np.zeros(n_points + 1, np.int64)
    for i in range(obs_point.shape[0]):
        start[obs_point[i] + 1] += 1
    for p in range(n_points):
        start[p + 1] += start[p]
    cursor = start[:-1].copy()
    order = np.empty(obs_point.shape[0], np.int64)
    for i in range(obs_point.shape[0]):
        p = obs_point[i]
        order[cursor[p]] = i
        cursor[p] += 1
    return start, order


@njit(cache=True, nogil=True, error_model="numpy")
def errors(T, points, camera, point, pixels, weights, intrinsics):
    """Squared errors in units of the variance, and a mask of positive depths.

    An observation at or behind the camera plane has an infinite error.
    """
    m = camera.shape[0]
    chi2 = np.full(m, np.inf)
    positive = np.zeros(m, np.bool_)
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    for i in range(m):
        pose, x = T[camera[i]], points[point[i]]
        z = pose[2, 0] * x[0] + pose[2, 1] * x[1] + pose[2, 2] * x[2] + pose[2, 3]
        if not z > MIN_DEPTH:
            continue
        eu = fx * (pose[0, 0] * x[0] + pose[0, 1] * x[1] + pose[0, 2] * x[2] + pose[0, 3]) / z
        ev = fy * (pose[1, 0] * x[0] + pose[1, 1] * x[1] + pose[1, 2] * x[2] + pose[1, 3]) / z
        eu += cx - pixels[i, 0]
        ev += cy - pixels[i, 1]
        chi2[i] = weights[i] * (eu * eu + ev * ev)
        positive[i] = True
    return chi2, positive


@njit(cache=True, nogil=True, error_model="numpy")
def robust_cost(T, points, start, camera, pixels, weights, intrinsics, huber2):
    """Sum of the losses over the points with two observations or more.

    They are squared errors, above a bound ``huber2`` Huber's; below 0 those of Student's t.
    """
    cost = 0.0
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
                inv_z = 1.0 / z
                x = (pose[0, 0] * px + pose[0, 1] * py + pose[0, 2] * pz + pose[0, 3]) * inv_z
                y = (pose[1, 0] * px + pose[1, 1] * py + pose[1, 2] * pz + pose[1, 3]) * inv_z
                eu = fx * x + cx - pixels[i, 0]
                ev = fy * y + cy - pixels[i, 1]
                chi2 = weights[i] * (eu * eu + ev * ev)
            if huber2 < 0.0:
                cost += loss_at(chi2)
            elif 0.0 < huber2 < chi2:
                cost += 2.0 * np.sqrt(huber2 * chi2) - huber2
            else:
                cost += chi2
    return cost


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations(
    T, points, start, camera, pixels, weights, intrinsics, huber2, slot, U, V, W, gradient_c, gradient_p
):
    """Compute the Gauss-Newton model of half the cost, in blocks.

    Written: ``U`` (F, 6, 6) camera blocks, ``V`` (P, 3, 3) point blocks, ``W`` (M, 6, 3) camera-point
    blocks (those of free cameras), ``gradient_c`` (F, 6) and ``gradient_p`` (P, 3). Camera steps are
    twists from the left. An observation behind its camera contributes nothing.
    """
    U[:] = 0.0
    V[:] = 0.0
    gradient_c[:] = 0.0
    gradient_p[:] = 0.0
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    Ju, Jv = np.zeros(6, np.float64), np.zeros(6, np.float64)
    Au, Av = np.zeros(3, np.float64), np.zeros(3, np.float64)
    for p in range(points.shape[0]):
        if start[p + 1] - start[p] < 2:
            continue
        px, py, pz = points[p, 0], points[p, 1], points[p, 2]
        for i in range(start[p], start[p + 1]):
            f = slot[camera[i]]
            pose = T[camera[i]]
            z = pose[2, 0] * px + pose[2, 1] * py + pose[2, 2] * pz + pose[2, 3]
            if not z > MIN_DEPTH:
                W[i] = 0.0
                continue
            inv_z = 1.0 / z
            x = (pose[0, 0] * px + pose[0, 1] * py + pose[0, 2] * pz + pose[0, 3]) * inv_z
            y = (pose[1, 0] * px + pose[1, 1] * py + pose[1, 2] * pz + pose[1, 3]) * inv_z
            eu = fx * x + cx - pixels[i, 0]
            ev = fy * y + cy - pixels[i, 1]
            weight = weights[i]
            chi2 = weight * (eu * eu + ev * ev)
            if huber2 < 0.0:
                weight *= weight_at(chi2)
            elif 0.0 < huber2 < chi2:
                weight *= np.sqrt(huber2 / chi2)
            for k in range(3):
                Au[k] = fx * inv_z * (pose[0, k] - x * pose[2, k])
                Av[k] = fy * inv_z * (pose[1, k] - y * pose[2, k])
            for r in range(3):
                gradient_p[p, r] += weight * (Au[r] * eu + Av[r] * ev)
                for c in range(r + 1):
                    V[p, r, c] += weight * (Au[r] * Au[c] + Av[r] * Av[c])
            if f < 0:
                continue
            Ju[0], Ju[2] = fx * inv_z, -fx * x * inv_z
            Ju[3], Ju[4], Ju[5] = -fx * x * y, fx * (1.0 + x * x), -fx * y
            Jv[1], Jv[2] = fy * inv_z, -fy * y * inv_z
            Jv[3], Jv[4], Jv[5] = -fy * (1.0 + y * y), fy * x * y, fy * x
            for r in range(6):
                wu, wv = weight * Ju[r], weight * Jv[r]
                gradient_c[f, r] += wu * eu + wv * ev
                for c in range(3):
                    W[i, r, c] = wu * Au[c] + wv * Av[c]
            add_outer_products(U, f, Ju, Jv, weight)


@njit(cache=True, nogil=True, error_model="numpy")
def move_points(points, step, T, start, camera, moved):
    """Move points by a step that is taken in inverse depth, as seen from their first camera.

    The image of a point depends on its depth by the inverse: a step along the ray that is linear in it
    arrives where one linear in the depth falls short, or goes on through the camera.
    """
    for p in range(points.shape[0]):
        for k in range(3):
            moved[p, k] = points[p, k] + step[p, k]
        if start[p + 1] - start[p] < 2:
            continue
        pose = T[camera[start[p]]]
        z, dz = pose[2, 3], 0.0
        for k in range(3):
            z += pose[2, k] * points[p, k]
            dz += pose[2, k] * step[p, k]
        if not z > MIN_DEPTH:
            continue
        grown = 1.0 / (1.0 - min(dz / z, _MOST_APPROACH))
        # Of the camera's axes, the rays turn as they do by the linear step; the depth is multiplied.
        for k in range(3):
            centre = -(pose[0, k] * pose[0, 3] + pose[1, k] * pose[1, 3] + pose[2, k] * pose[2, 3])
            ray = points[p, k] - centre
            moved[p, k] = centre + grown * (ray + step[p, k] - ray * dz / z)


@njit(cache=True, nogil=True, error_model="numpy")
def adjust(T, points, start, camera, pixels, weights, intrinsics, slot, n_free, iterations, huber2):
    """Minimise the cost over ``T`` and ``points`` by Levenberg-Marquardt, in place.

    A step that does not lower the cost is undone and the damping raised.

    Returns:
        The cost before and after.
    """
    n_points, m = points.shape[0], camera.shape[0]
    model = (
        np.empty((n_free, 6, 6)), np.empty((n_points, 3, 3)), np.empty((m, 6, 3)),
        np.empty((n_free, 6)), np.empty((n_points, 3)),
    )  # fmt: skip
    room = (
        skyline(start, camera, slot, n_free), np.empty((n_points, 3, 3)), np.zeros(n_points, np.bool_),
        np.empty((6 * n_free, 6 * n_free)), np.empty(6 * n_free), np.empty((n_points, 3)), np.empty(1),
    )  # fmt: skip
    observed = start, camera, pixels, weights, intrinsics, huber2
    initial = robust_cost(T, points, *observed)
    # Reweighting converges slowly: a small gain says less there. A thousandth of a
    # log-likelihood tells nothing.
    tolerance = 1e-7 if huber2 == 0.0 else 1e-9 if huber2 > 0.0 else 1e-3 / max(initial, 1.0)
    problem = T, points, T.copy(), points.copy(), observed, slot, model, room
    cost, _ = minimise(_linearise, _propose, _accept, problem, initial, iterations, 1e-4, tolerance)
    return initial, cost


@njit(inline="always")
def _linearise(problem):
    T, points, _, _, observed, slot, model, _ = problem
    normal_equations(T, points, *observed, slot, *model)


@njit(inline="always")
def _propose(problem, damping):
    T, points, trial_T, trial_points, observed, slot, model, room = problem
    start, camera, _, _, _, _ = observed
    U, V, W, gradient_c, gradient_p = model
    first, V_inv, held, S, step_c, step_p, moved2 = room
    eliminate_points(*model, start, camera, slot, damping, first, V_inv, held, S, step_c)
    if not factor(S, first):
        return np.inf, np.inf
    step = step_c.copy()  # the right side, before it is solved
    solve(S, first, step)
    moved2[0] = step @ step_c if len(step) and damping < _LITTLE_DAMPING else np.inf
    step_c[:] = step
    back_substitute(W, gradient_p, start, camera, slot, V_inv, held, step_c, step_p)
    predicted = predicted_gain(U, V, gradient_c, gradient_p, damping, step_c, step_p, held)
    for k in range(T.shape[0]):
        if slot[k] >= 0:
            retract(T[k], step_c[6 * slot[k] : 6 * slot[k] + 6], trial_T[k])
    move_points(points, step_p, T, start, camera, trial_points)
    return robust_cost(trial_T, trial_points, *observed), predicted


@njit(inline="always")
def _accept(problem):
    T, points, trial_T, trial_points, observed, _, _, room = problem
    T[:], points[:] = trial_T, trial_points
    return observed[-1] < 0.0 and room[-1][0] <= _ARRIVED
