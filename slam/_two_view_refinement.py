"""Refinement of a relative pose over what all matches say.

A match speaks against a motion in two ways: its keypoints lie off each other's epipolar lines, or they lie on
them the wrong way along, so that no point in front of both cameras explains them and the nearest that does is
at infinity. Both are errors in pixels and make one cost. It tells the mirrored motion from the true one, and
takes a point behind a camera no more seriously than it is clearly behind.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from slam.optimization._se3 import so3_exp

TUKEY = 4.685
"""Errors of more sigmas count no more; this loses 5 % of efficiency under normal noise."""

_PARAMETERS = 5
_STEP = 1e-6
_DAMPING = 1e-3
_RETRIES = 6
_CONVERGED = 1e-5
_PRIOR = 1e-2
"""Information on each parameter before any match, 1/rad²: next to none, but equations are never singular."""


class RefinedMotion(NamedTuple):
    """A relative pose at a minimum of its robust cost.

    Attributes:
        T_2_1: (4, 4) camera 1 to camera 2, translation of unit length.
        errors: (N, 2) off the epipolar line and behind the cameras, in sigmas.
        costs: (N,) what each match adds to the cost, ``TUKEY**2 / 3`` at the most.
        information: (5, 5), or (3, 3) where the direction was kept, on the steps of ``moved``, 1/rad²; right
            if the noise given was.
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
    """The minimum of the robust cost of all matches next to a motion.

    Args:
        T_2_1: (4, 4) motion to start from, translation of unit length.
        rays_1, rays_2: (N, 2) normalised keypoints.
        sigma: (N,) their noise, normalised units.
        widest: the first iteration takes errors seriously that are so many times too large, the next half
            as many, and so on down to one: the larger, the farther away a minimum is found.
        iterations: cap.
        turn_only: keep the direction of the translation.
    """
    free = 3 if turn_only else _PARAMETERS
    return RefinedMotion(*refine_motion(T_2_1, rays_1, rays_2, sigma, widest, iterations, free))


@njit(cache=True, nogil=True, error_model="numpy")
def motion_errors(R, t, rays_1, rays_2, sigma, off, behind):
    """Errors of matches under a motion, in sigmas.

    Args:
        R, t: camera 1 to camera 2, unit baseline.
        rays_1, rays_2: (N, 2) normalised keypoints.
        sigma: (N,) their noise, normalised units.
        off: (N,) filled with the signed distances to the epipolar lines (Sampson's).
        behind: (N,) filled with the distances along the line to the image of infinity, negative, where the
            keypoint lies beyond it and its point behind a camera; zero elsewhere.

    Source: Sampson error: Hartley, Zisserman, "Multiple View Geometry", 2003, section 11.4.3.
    """
    r00, r01, r02, r10, r11, r12 = R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2]
    r20, r21, r22, t0, t1, t2 = R[2, 0], R[2, 1], R[2, 2], t[0], t[1], t[2]
    # Squared norm of the upper left 2x2 block of the essential matrix [t]x R.
    corner = (t1 * r20 - t2 * r10) ** 2 + (t1 * r21 - t2 * r11) ** 2
    corner += (t2 * r00 - t0 * r20) ** 2 + (t2 * r01 - t0 * r21) ** 2
    for i in range(len(sigma)):
        x1, y1, x2, y2, s = rays_1[i, 0], rays_1[i, 1], rays_2[i, 0], rays_2[i, 1], sigma[i]
        qx = r00 * x1 + r01 * y1 + r02
        qy = r10 * x1 + r11 * y1 + r12
        qz = r20 * x1 + r21 * y1 + r22
        # Epipolar lines: t x q in view 2, R^T (ray_2 x t) in view 1.
        a, b, c = t1 * qz - t2 * qy, t2 * qx - t0 * qz, t0 * qy - t1 * qx
        mx, my, mz = y2 * t2 - t1, t0 - x2 * t2, x2 * t1 - y2 * t0
        d, e = r00 * mx + r10 * my + r20 * mz, r01 * mx + r11 * my + r21 * mz
        # Second order of the noise: it matters near the epipoles, where the lines lose their direction.
        noise = s * s * corner + 1e-300
        off[i] = (x2 * a + y2 * b + c) / (np.sqrt(a * a + b * b + d * d + e * e + noise) * s)
        behind[i] = 0.0
        if qz <= 0.0:
            behind[i] = -1.0 / s
            continue
        # Way from the image of infinity to the keypoint, in the direction in which nearer points lie. It is
        # taken at the end farther from the epipole, so that what is beyond the epipole is behind.
        du, dv = my, -mx
        if t2 < 0.0:
            du, dv = t0 - qx / qz * t2, t1 - qy / qz * t2
        along = (x2 - qx / qz) * du + (y2 - qy / qz) * dv
        if along < 0.0:
            behind[i] = along / (np.sqrt(2.0 * (du * du + dv * dv + noise)) * s)


@njit(cache=True, nogil=True, error_model="numpy")
def _biweight(e2, c2):
    """Tukey's loss of a squared error; the squared error itself where small."""
    if e2 >= c2:
        return c2 / 3.0
    left = 1.0 - e2 / c2
    return c2 / 3.0 * (1.0 - left * left * left)


@njit(cache=True, nogil=True, error_model="numpy")
def _cost(off, behind, c2):
    total = 0.0
    for i in range(len(off)):
        total += _biweight(off[i] * off[i] + behind[i] * behind[i], c2)
    return total


@njit(cache=True, nogil=True)
def tangent(t):
    """Two unit vectors at right angles to each other and to the direction ``t``."""
    axis = np.zeros(3)
    axis[np.argmin(np.abs(t))] = 1.0
    u = np.cross(t, axis)
    u /= np.sqrt((u * u).sum())
    return u, np.cross(t, u)


@njit(cache=True, nogil=True)
def moved(R, t, step):
    """The motion turned by ``step[:3]`` from the left and its direction moved by ``step[3:]``, rad."""
    u, v = tangent(t)
    direction = t + step[3] * u + step[4] * v
    return so3_exp(step[0], step[1], step[2]) @ R, direction / np.sqrt((direction * direction).sum())


@njit(cache=True, nogil=True, error_model="numpy")
def _linearise(R, t, rays_1, rays_2, sigma, c2, off, behind, H, g):
    """Fill the normal equations of the reweighted squares, in the first ``len(g)`` parameters."""
    n, free = len(sigma), len(g)
    J, K, step = np.empty((free, n)), np.empty((free, n)), np.zeros(_PARAMETERS)
    for p in range(free):
        step[p] = _STEP
        R_p, t_p = moved(R, t, step)
        step[p] = 0.0
        motion_errors(R_p, t_p, rays_1, rays_2, sigma, J[p], K[p])
    H[:] = 0.0
    g[:] = 0.0
    j, k = np.empty(free), np.empty(free)
    for i in range(n):
        e2 = off[i] * off[i] + behind[i] * behind[i]
        if e2 >= c2:
            continue
        w = (1.0 - e2 / c2) ** 2
        for p in range(free):
            j[p], k[p] = (J[p, i] - off[i]) / _STEP, (K[p, i] - behind[i]) / _STEP
            g[p] += w * (j[p] * off[i] + k[p] * behind[i])
            for q in range(p + 1):
                H[p, q] += w * (j[p] * j[q] + k[p] * k[q])
    for p in range(free):
        for q in range(p):
            H[q, p] = H[p, q]


@njit(cache=True, nogil=True, error_model="numpy")
def refine_motion(T_2_1, rays_1, rays_2, sigma, widest, iterations, free):
    """Levenberg-Marquardt over the robust cost of all matches; arguments as for :func:`refined`.

    Args:
        free: 5, or 3 to keep the direction.

    Returns:
        The fields of :class:`RefinedMotion`.
    """
    n = len(sigma)
    R, t = T_2_1[:3, :3].copy(), T_2_1[:3, 3].copy()
    H, g, step = np.empty((free, free)), np.empty(free), np.zeros(_PARAMETERS)
    off, behind, off_new, behind_new = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    motion_errors(R, t, rays_1, rays_2, sigma, off, behind)
    damping = _DAMPING
    for _ in range(iterations):
        final = widest <= 1.0
        c2 = (TUKEY * max(widest, 1.0)) ** 2
        widest *= 0.5
        cost = _cost(off, behind, c2)
        _linearise(R, t, rays_1, rays_2, sigma, c2, off, behind, H, g)
        gain = 0.0
        for _retry in range(_RETRIES):
            A = H.copy()
            for p in range(free):
                A[p, p] += damping * H[p, p] + _PRIOR
            step[:free] = -np.linalg.solve(A, g)
            R_new, t_new = moved(R, t, step)
            motion_errors(R_new, t_new, rays_1, rays_2, sigma, off_new, behind_new)
            gain = cost - _cost(off_new, behind_new, c2)
            if gain > 0.0:
                R, t = R_new, t_new
                off, off_new = off_new, off
                behind, behind_new = behind_new, behind
                damping = max(0.1 * damping, 1e-9)
                break
            damping *= 10.0
        if final and gain < _CONVERGED * cost:
            break
    _linearise(R, t, rays_1, rays_2, sigma, TUKEY**2, off, behind, H, g)
    for p in range(free):
        H[p, p] += _PRIOR
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    errors, costs = np.empty((n, 2)), np.empty(n)
    for i in range(n):
        errors[i, 0], errors[i, 1] = off[i], behind[i]
        costs[i] = _biweight(off[i] * off[i] + behind[i] * behind[i], TUKEY**2)
    return T, errors, costs, H
