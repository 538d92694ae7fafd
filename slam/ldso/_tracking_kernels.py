"""Kernels of the tracker: an image against the projected points of a keyframe.

Names as in :mod:`slam.direct._alignment_kernels`. Cutoffs follow the public code of the authors of "Direct
Sparse Odometry".
"""

import numpy as np
from numba import njit

from dslab.slam.direct._alignment_kernels import linearise, residual_energy
from dslab.slam.optimization._se3 import retract

_DAMPING = 1e-2
_LEAST_DAMPING = 1e-6
_MOST_DAMPING = 1e6


@njit(cache=True, nogil=True)
def refine(
    level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, prior, huber, cutoff, iterations,
    depth, still,
):  # fmt: skip
    """Levenberg steps on one level.

    Args:
        level, camera, uv, inverse_depth, pattern, intensity, weight, huber, cutoff: as of ``linearise``.
        T, affine: (4, 4) and (2,) to begin with; changed in place.
        prior: (2,) information on a and b.
        iterations: most steps.
        depth: usual depth, the unit of steps of position.
        still: largest step, in rad and depths, that is none.

    Returns:
        Mean cost of a pixel; number of pixels compared; of these, beyond the cutoff.
    """
    H, gradient, scale = np.empty((8, 8)), np.empty(8), np.ones(8)
    H_there, gradient_there, A = np.empty((8, 8)), np.empty(8), np.empty((8, 8))
    scale[:3] = depth
    moved, moved_affine = np.eye(4), np.empty(2)
    energy, seen, saturated = linearise(
        level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, huber, cutoff, H, gradient
    )
    if seen < 8:
        return np.inf, seen, saturated
    cost = (energy + prior[0] * affine[0] ** 2 + prior[1] * affine[1] ** 2) / seen
    damping = _DAMPING
    for _ in range(iterations):
        for m in range(8):
            for n in range(8):
                A[m, n] = H[m, n] * scale[m] * scale[n]
            if m >= 6:
                A[m, m] += prior[m - 6]
            A[m, m] += damping * A[m, m] + 1e-9
        g = gradient * scale
        g[6] += prior[0] * affine[0]
        g[7] += prior[1] * affine[1]
        step = -np.linalg.solve(A, g)
        size = np.abs(step[:6]).max()
        retract(T, step[:6] * scale[:6], moved)
        moved_affine[0], moved_affine[1] = affine[0] + step[6], affine[1] + step[7]
        energy, seen_there, saturated_there = linearise(
            level, camera, uv, inverse_depth, pattern, intensity, weight, moved, moved_affine, huber, cutoff,
            H_there, gradient_there,
        )  # fmt: skip
        there = np.inf
        if seen_there >= 8:
            there = energy + prior[0] * moved_affine[0] ** 2 + prior[1] * moved_affine[1] ** 2
            there /= seen_there
        if there < cost:
            T[:], affine[:] = moved, moved_affine
            H[:], gradient[:] = H_there, gradient_there
            cost, seen, saturated = there, seen_there, saturated_there
            damping = max(damping / 4.0, _LEAST_DAMPING)
            if size < still:
                break
        elif size < still or damping > _MOST_DAMPING:
            break
        else:
            damping *= 8.0
    return cost, seen, saturated


@njit(cache=True, nogil=True)
def widened_cutoff(
    level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, huber, cutoff, share, most
):  # fmt: skip
    """The cutoff, doubled up to ``most`` while more than a share of the residuals is beyond it."""
    while cutoff < most:
        _, seen, saturated = residual_energy(
            level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, huber, cutoff
        )
        if saturated <= share * seen:
            break
        cutoff *= 2.0
    return cutoff


@njit(cache=True, nogil=True)
def mean_squared_flow(camera, uv, inverse_depth, T):
    """Mean squared motion of pixels, px²: by the translation alone, and by the whole motion.

    Pixels that leave the image count as well; those behind the camera do not.
    """
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    alone, whole, count = 0.0, 0.0, 0
    for i in range(uv.shape[0]):
        x, y, d = (uv[i, 0] - cx) / fx, (uv[i, 1] - cy) / fy, inverse_depth[i]
        z = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * d
        z_alone = 1.0 + T[2, 3] * d
        if z <= 1e-6 or z_alone <= 1e-6:
            continue
        du = fx * ((x + T[0, 3] * d) / z_alone - x)
        dv = fy * ((y + T[1, 3] * d) / z_alone - y)
        alone += du * du + dv * dv
        du = fx * ((T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * d) / z - x)
        dv = fy * ((T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * d) / z - y)
        whole += du * du + dv * dv
        count += 1
    if count == 0:
        return np.inf, np.inf
    return alone / count, whole / count
