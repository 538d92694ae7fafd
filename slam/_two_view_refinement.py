"""Refinement of a relative pose over its epipolar errors, and how well they determine it."""

from typing import NamedTuple

import numpy as np
from numba import njit

_STEP = 1e-6


class RefinedMotion(NamedTuple):
    """A relative pose at the minimum of its robust epipolar cost.

    Attributes:
        T_2_1: (4, 4), translation of unit length.
        errors: (N,) squared Sampson errors over the noise variance.
        cost: robust (Huber) sum of them.
        direction_std_deg: standard deviation of the translation's direction, in its worst direction.
    """

    T_2_1: np.ndarray
    errors: np.ndarray
    cost: float
    direction_std_deg: float


@njit(cache=True, nogil=True)
def _sampson(R, t, rays_1, rays_2, out):
    """Signed Sampson errors of matched normalised keypoints (N, 2), in normalised units."""
    E = np.empty((3, 3))
    for c in range(3):
        E[0, c] = t[1] * R[2, c] - t[2] * R[1, c]
        E[1, c] = t[2] * R[0, c] - t[0] * R[2, c]
        E[2, c] = t[0] * R[1, c] - t[1] * R[0, c]
    for i in range(len(out)):
        x1, y1 = rays_1[i, 0], rays_1[i, 1]
        x2, y2 = rays_2[i, 0], rays_2[i, 1]
        a = E[0, 0] * x1 + E[0, 1] * y1 + E[0, 2]
        b = E[1, 0] * x1 + E[1, 1] * y1 + E[1, 2]
        c = E[2, 0] * x1 + E[2, 1] * y1 + E[2, 2]
        d = E[0, 0] * x2 + E[1, 0] * y2 + E[2, 0]
        e = E[0, 1] * x2 + E[1, 1] * y2 + E[2, 1]
        out[i] = (x2 * a + y2 * b + c) / np.sqrt(a * a + b * b + d * d + e * e + 1e-300)


@njit(cache=True, nogil=True)
def _moved(R, t, delta):
    """The pose after a small turn ``delta[:3]`` and a move of the direction in its tangent plane."""
    x, y, z = delta[0], delta[1], delta[2]
    angle = np.sqrt(x * x + y * y + z * z)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-12:
        turn = np.eye(3) + skew
    else:
        turn = (
            np.eye(3) + np.sin(angle) / angle * skew + (1.0 - np.cos(angle)) / (angle * angle) * (skew @ skew)
        )
    axis = np.zeros(3)
    axis[np.argmin(np.abs(t))] = 1.0
    u = np.cross(t, axis)
    u /= np.sqrt((u * u).sum())
    v = np.cross(t, u)
    moved = t + delta[3] * u + delta[4] * v
    return turn @ R, moved / np.sqrt((moved * moved).sum())


@njit(cache=True, nogil=True)
def _robust_cost(errors, huber):
    cost = 0.0
    for e in errors:
        a = abs(e)
        cost += a * a if a <= huber else 2 * huber * a - huber * huber
    return cost


@njit(cache=True, nogil=True)
def refine_motion(T_2_1, rays_1, rays_2, sigma, iterations):
    """Levenberg-Marquardt over the robust Sampson cost of all matches.

    Args:
        T_2_1: (4, 4) starting motion, translation of unit length.
        rays_1, rays_2: (N, 2) normalised keypoints.
        sigma: their noise, normalised units.
        iterations: cap.

    Source: Sampson error: Hartley, Zisserman, "Multiple View Geometry", 2003, section 11.4.3.
    """
    n = len(rays_1)
    R = np.ascontiguousarray(T_2_1[:3, :3])
    t = np.ascontiguousarray(T_2_1[:3, 3])
    errors, trial = np.empty(n), np.empty(n)
    J = np.empty((n, 5))
    _sampson(R, t, rays_1, rays_2, errors)
    errors /= sigma
    huber, damping = 2.0, 1e-3
    cost = _robust_cost(errors, huber)
    H = np.zeros((5, 5))
    for _ in range(iterations):
        for p in range(5):
            delta = np.zeros(5)
            delta[p] = _STEP
            R_p, t_p = _moved(R, t, delta)
            _sampson(R_p, t_p, rays_1, rays_2, trial)
            for i in range(n):
                J[i, p] = (trial[i] / sigma - errors[i]) / _STEP
        g = np.zeros(5)
        H[:] = 0.0
        for i in range(n):
            w = min(1.0, huber / max(abs(errors[i]), 1e-12))
            for p in range(5):
                g[p] += w * J[i, p] * errors[i]
                for q in range(5):
                    H[p, q] += w * J[i, p] * J[i, q]
        improved = False
        for _retry in range(6):
            A = H.copy()
            for p in range(5):
                A[p, p] += damping * H[p, p] + 1e-9
            R_n, t_n = _moved(R, t, -np.linalg.solve(A, g))
            _sampson(R_n, t_n, rays_1, rays_2, trial)
            trial /= sigma
            new_cost = _robust_cost(trial, huber)
            if new_cost < cost:
                improved = True
                break
            damping *= 10.0
        if not improved:
            break
        gain = cost - new_cost
        R, t, cost = R_n, t_n, new_cost
        errors[:] = trial
        damping = max(damping * 0.1, 1e-9)
        if gain < 1e-4 * cost:
            break
    covariance = np.linalg.inv(H + 1e-9 * np.eye(5))
    direction = covariance[3:, 3:]
    half = 0.5 * (direction[0, 0] + direction[1, 1])
    spread = np.sqrt(0.25 * (direction[0, 0] - direction[1, 1]) ** 2 + direction[0, 1] ** 2)
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T, errors * errors, cost, np.degrees(np.sqrt(half + spread))
