"""Elimination of the points from the normal equations of bundle adjustment, and back-substitution.

Blocks as in the bundle adjustment kernels: ``U`` (F, 6, 6) cameras, ``V`` (P, 3, 3) points, ``W`` (M, 6, 3)
camera against point, observations sorted by point.
"""

import numpy as np
from numba import njit

from dslab.slam.optimization._block_sums import subtract_products


@njit(cache=True, nogil=True, error_model="numpy")
def skyline(start, camera, slot, n_free):
    """(6 F,) int64 first column that can be nonzero in each row of the reduced camera matrix."""
    lowest = np.arange(n_free)
    for p in range(start.shape[0] - 1):
        least = n_free
        for i in range(start[p], start[p + 1]):
            f = slot[camera[i]]
            if 0 <= f < least:
                least = f
        for i in range(start[p], start[p + 1]):
            f = slot[camera[i]]
            if f >= 0 and least < lowest[f]:
                lowest[f] = least
    return np.repeat(6 * lowest, 6)


@njit(cache=True, nogil=True, error_model="numpy")
def _invert_3x3(V, damping, inverse):
    """Invert a symmetric block (lower triangle) with damped diagonal; False if singular."""
    floor = 1e-12 * (V[0, 0] + V[1, 1] + V[2, 2]) + 1e-30
    a = V[0, 0] * (1.0 + damping) + floor
    d = V[1, 1] * (1.0 + damping) + floor
    g = V[2, 2] * (1.0 + damping) + floor
    b, c, e = V[1, 0], V[2, 0], V[2, 1]
    m00, m01, m02 = d * g - e * e, c * e - b * g, b * e - c * d
    determinant = a * m00 + b * m01 + c * m02
    if not determinant > 1e-18 * a * d * g:
        return False
    s = 1.0 / determinant
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = s * m00, s * m01, s * m02
    inverse[1, 1], inverse[1, 2], inverse[2, 2] = (
        s * (a * g - c * c),
        s * (b * c - a * e),
        s * (a * d - b * b),
    )
    inverse[1, 0], inverse[2, 0], inverse[2, 1] = inverse[0, 1], inverse[0, 2], inverse[1, 2]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def eliminate_points(
    U, V, W, gradient_c, gradient_p, start, camera, slot, damping, first, V_inv, held, S, reduced
):
    """Fill the reduced camera system ``S x = reduced`` for the damped step.

    Written: ``V_inv`` (P, 3, 3), ``held`` (P,) bool points without a step, the lower triangle of ``S``
    (6 F, 6 F) within the skyline ``first``, ``reduced`` (6 F,).
    """
    n_free = U.shape[0]
    for i in range(6 * n_free):
        S[i, first[i] : i + 1] = 0.0
    for f in range(n_free):
        floor = 1e-12 * np.trace(U[f]) + 1e-30
        for r in range(6):
            for c in range(r + 1):
                S[6 * f + r, 6 * f + c] = U[f, r, c]
            S[6 * f + r, 6 * f + r] += damping * U[f, r, r] + floor
            reduced[6 * f + r] = -gradient_c[f, r]
    most = _most_observations(start)
    Y, turned, free = np.empty((3, 6)), np.empty((most, 3, 6)), np.empty(most, np.int64)
    for p in range(start.shape[0] - 1):
        held[p] = start[p + 1] - start[p] < 2 or not _invert_3x3(V[p], damping, V_inv[p])
        if held[p]:
            continue
        n = 0
        for i in range(start[p], start[p + 1]):
            f = slot[camera[i]]
            if f < 0:
                continue
            free[n] = f
            for r in range(6):
                for c in range(3):
                    turned[n, c, r] = W[i, r, c]
            n += 1
        for a in range(n):
            f = free[a]
            for c in range(3):
                in_0, in_1, in_2 = V_inv[p, 0, c], V_inv[p, 1, c], V_inv[p, 2, c]
                for r in range(6):
                    Y[c, r] = turned[a, 0, r] * in_0 + turned[a, 1, r] * in_1 + turned[a, 2, r] * in_2
            for r in range(6):
                reduced[6 * f + r] += (
                    Y[0, r] * gradient_p[p, 0] + Y[1, r] * gradient_p[p, 1] + Y[2, r] * gradient_p[p, 2]
                )
            for b in range(n):
                if free[b] <= f:
                    subtract_products(S, 6 * f, 6 * free[b], Y, turned, b)


@njit(cache=True, nogil=True, error_model="numpy")
def _most_observations(start):
    most = 0
    for p in range(start.shape[0] - 1):
        most = max(most, start[p + 1] - start[p])
    return most


@njit(cache=True, nogil=True, error_model="numpy")
def back_substitute(W, gradient_p, start, camera, slot, V_inv, held, step_c, step_p):
    """Compute the point steps ``step_p`` (P, 3) from the camera steps ``step_c`` (6 F,)."""
    for p in range(start.shape[0] - 1):
        step_p[p] = 0.0
        if held[p]:
            continue
        b0, b1, b2 = -gradient_p[p, 0], -gradient_p[p, 1], -gradient_p[p, 2]
        for i in range(start[p], start[p + 1]):
            f = slot[camera[i]]
            if f < 0:
                continue
            for r in range(6):
                b0 -= W[i, r, 0] * step_c[6 * f + r]
                b1 -= W[i, r, 1] * step_c[6 * f + r]
                b2 -= W[i, r, 2] * step_c[6 * f + r]
        for r in range(3):
            step_p[p, r] = V_inv[p, r, 0] * b0 + V_inv[p, r, 1] * b1 + V_inv[p, r, 2] * b2


@njit(cache=True, nogil=True, error_model="numpy")
def predicted_gain(U, V, gradient_c, gradient_p, damping, step_c, step_p, held):
    """Decrease of the cost that the model predicts for the damped step."""
    gain = 0.0
    for f in range(U.shape[0]):
        for r in range(6):
            d = step_c[6 * f + r]
            gain += d * (damping * U[f, r, r] * d - gradient_c[f, r])
    for p in range(step_p.shape[0]):
        if held[p]:
            continue
        for r in range(3):
            d = step_p[p, r]
            gain += d * (damping * V[p, r, r] * d - gradient_p[p, r])
    return gain
