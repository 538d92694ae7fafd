"""Refinement of a relative pose on all matches.

A match contradicts a motion in two ways: its keypoints lie off the epipolar lines, or they lie on the wrong
side of the image of infinity, so that no point in front of both cameras explains them. Both errors are in
pixels and form one cost. It separates the mirrored motion from the true one, and weighs a point behind a
camera by how clearly it is behind.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from dslab.slam.initialization._two_view_errors import motion_errors, normal_equations
from dslab.slam.optimization._cholesky import factor, solve, whole_rows
from dslab.slam.optimization._se3 import so3_exp

TUKEY = 4.685
"""Errors of more sigmas have no influence; this loses 5 % of efficiency under normal noise."""

_PARAMETERS = 5
_DAMPING = 1e-3
_RETRIES = 6
_CONVERGED = 1e-5
_PRIOR = 1e-2
"""Prior information on each parameter, 1/rad²: negligible, but it keeps the equations regular."""


class RefinedMotion(NamedTuple):
    """A relative pose at a minimum of its robust cost.

    Attributes:
        T_2_1: (4, 4) camera 1 to camera 2, translation of unit length.
        errors: (N, 2) off the epipolar line and behind the cameras, in sigmas.
        costs: (N,) contribution of each match to the cost, at most ``TUKEY**2 / 3``.
        information: (5, 5), or (3, 3) if the direction was fixed, on the steps of ``moved``, 1/rad²; correct
            if the given noise is.
    """

    T_2_1: np.ndarray
    errors: np.ndarray
    costs: np.ndarray
    information: np.ndarray

    @property
    def cost(self) -> float:
        """Sum of the costs."""
        return float(self.costs.sum())


def refined(
    T_2_1: np.ndarray,
    rays_1: np.ndarray,
    rays_2: np.ndarray,
    sigma: np.ndarray,
    *,
    widest: float = 1.0,
    iterations: int = 20,
    turn_only: bool = False,
) -> RefinedMotion:
    """Find the minimum of the robust cost of all matches near a motion.

    Args:
        T_2_1: (4, 4) motion to start from, translation of unit length.
        rays_1, rays_2: (N, 2) normalised keypoints.
        sigma: (N,) their noise, normalised units.
        widest: factor on the loss's width in the first iteration, halved in each further one down to 1; a
            larger one finds minima farther away.
        iterations: most iterations.
        turn_only: keep the direction of the translation.
    """
    free = 3 if turn_only else _PARAMETERS
    matches = np.empty((5, len(sigma)))
    matches[:2], matches[2:4], matches[4] = rays_1.T, rays_2.T, sigma
    T, errors, costs, information = refine_motion(T_2_1, matches, float(widest), iterations, free)
    return RefinedMotion(T, errors.T, costs, information)


@njit(cache=True, nogil=True)
def tangent(t):
    """Two unit vectors orthogonal to each other and to the direction ``t``."""
    axis = np.zeros(3)
    axis[np.argmin(np.abs(t))] = 1.0
    u = np.cross(t, axis)
    u /= np.sqrt((u * u).sum())
    return u, np.cross(t, u)


@njit(cache=True, nogil=True)
def moved(R, t, step):
    """Apply a step: rotation ``step[:3]`` from the left, direction moved by ``step[3:]``, rad."""
    u, v = tangent(t)
    direction = t + step[3] * u + step[4] * v
    return so3_exp(step[0], step[1], step[2]) @ R, direction / np.sqrt((direction * direction).sum())


@njit(cache=True, nogil=True)
def _damped_step(H, g, damping, free, step):
    """Fill ``step[:free]``; return False if the equations cannot be solved."""
    A = np.empty((free, free))
    for p in range(free):
        A[p, : p + 1] = H[p, : p + 1]
        A[p, p] += damping * H[p, p] + _PRIOR
        step[p] = -g[p]
    rows = whole_rows(free)
    if not factor(A, rows):
        return False
    solve(A, rows, step[:free])
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _errors_and_costs(R, t, matches):
    n = matches.shape[1]
    errors, costs, c2 = np.empty((2, n)), np.empty(n), TUKEY**2
    motion_errors(R, t, matches, errors)
    for i in range(n):
        left = max(1.0 - (errors[0, i] ** 2 + errors[1, i] ** 2) / c2, 0.0)
        costs[i] = c2 / 3.0 * (1.0 - left * left * left)
    return errors, costs


@njit(cache=True, nogil=True, error_model="numpy")
def refine_motion(T_2_1, matches, widest, iterations, free):
    """Minimise the robust cost of all matches by Levenberg-Marquardt; arguments as of :func:`refined`.

    Every step is evaluated together with the equations of the next one, since most steps are accepted.

    Args:
        matches: (5, N).
        free: 5, or 3 to keep the direction.

    Returns:
        Motion (4, 4), errors (2, N), costs (N,), information (free, free).
    """
    R, t = T_2_1[:3, :3].copy(), T_2_1[:3, 3].copy()
    H, g, step = np.zeros((_PARAMETERS, _PARAMETERS)), np.empty(_PARAMETERS), np.zeros(_PARAMETERS)
    H_new, g_new = np.zeros((_PARAMETERS, _PARAMETERS)), np.empty(_PARAMETERS)
    c2_next = (TUKEY * max(widest, 1.0)) ** 2
    u, v = tangent(t)
    cost, _ = normal_equations(R, t, u, v, matches, c2_next, c2_next, H, g)
    damping = _DAMPING
    for _ in range(iterations):
        final = widest <= 1.0
        widest *= 0.5
        c2, c2_next = c2_next, (TUKEY * max(widest, 1.0)) ** 2
        gain = 0.0
        for _retry in range(_RETRIES):
            solved = _damped_step(H, g, damping, free, step)
            damping *= 10.0
            if not solved:
                continue
            R_new, t_new = moved(R, t, step)
            u, v = tangent(t_new)
            cost_new, cost_next = normal_equations(R_new, t_new, u, v, matches, c2, c2_next, H_new, g_new)
            gain = cost - cost_new
            if gain > 0.0:
                R, t, cost = R_new, t_new, cost_next
                H, H_new, g, g_new = H_new, H, g_new, g
                damping = max(0.01 * damping, 1e-9)
                break
        if final and gain < _CONVERGED * cost:
            break
        if not gain > 0.0:
            u, v = tangent(t)
            cost, _ = normal_equations(R, t, u, v, matches, c2_next, c2_next, H, g)
    if c2_next > TUKEY**2:
        u, v = tangent(t)
        normal_equations(R, t, u, v, matches, TUKEY**2, TUKEY**2, H, g)
    information = np.empty((free, free))
    for p in range(free):
        for q in range(p + 1):
            information[p, q] = information[q, p] = H[p, q]
        information[p, p] += _PRIOR
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    errors, costs = _errors_and_costs(R, t, matches)
    return T, errors, costs, information
