"""Kernels of activation: which points are apart, and their inverse depths over all keyframes."""

import numpy as np
from numba import njit

from dslab.slam.direct._alignment_kernels import _bilinear
from dslab.slam.optimization._cholesky import whole_rows
from dslab.slam.optimization.least_squares import accept_trial, damped_step, is_known, minimise

_STEPS = 4  # of a depth; the window refines it further
_DAMPING = 1e-2
_TOLERANCE = 1e-3


@njit(cache=True, nogil=True)
def apart(at, distance, taken, kept):
    """Keep points, in their order, that are apart from those that are there and those kept before.

    Args:
        at: (N, 2) pixels of the candidates, in the image.
        distance: (N,) int64 pixels in x or y by which each must be apart.
        taken: (H, W) bool pixels of those that are there; those that are kept become true.
        kept: (N,) bool, written.
    """
    for i in range(at.shape[0]):
        x, y, d = int(at[i, 0]), int(at[i, 1]), distance[i]
        kept[i] = not taken[max(0, y - d) : y + d + 1, max(0, x - d) : x + d + 1].any()
        if kept[i]:
            taken[y, x] = True


@njit(cache=True, nogil=True)
def _pattern_model(level, camera, u0, v0, d, pattern, intensity, weight, T, gain, offset, huber, outlier):
    """Residual of a pattern of inverse depth d in a view.

    Returns:
        Cost; information on d; gradient of half the cost by d; 1 if it is seen and looks alike, 0 if it is
        seen and does not, -1 if it is not seen.
    """
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    energy, H, g = 0.0, 0.0, 0.0
    for k in range(pattern.shape[0]):
        x, y = (u0 + pattern[k, 0] - cx) / fx, (v0 + pattern[k, 1] - cy) / fy
        z = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * d
        if z <= 1e-6:
            return 0.0, 0.0, 0.0, -1
        px = (T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * d) / z
        py = (T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * d) / z
        u, v = fx * px + cx, fy * py + cy
        if not (1.0 <= u < level.shape[1] - 2 and 1.0 <= v < level.shape[0] - 2):
            return 0.0, 0.0, 0.0, -1
        r = _bilinear(level, u, v, 0) - gain * intensity[k] - offset
        slope = fx * _bilinear(level, u, v, 1) * (T[0, 3] - px * T[2, 3]) / z
        slope += fy * _bilinear(level, u, v, 2) * (T[1, 3] - py * T[2, 3]) / z
        if not abs(r) + abs(slope) < np.inf:
            return 0.0, 0.0, 0.0, -1
        size = abs(r)
        w = weight[k] * (1.0 if size <= huber else huber / size)
        energy += weight[k] * (size * size if size <= huber else huber * (2.0 * size - huber))
        H += w * slope * slope
        g += w * slope * r
    if energy > outlier:
        return outlier, 0.0, 0.0, 0
    return energy, H, g, 1


@njit(cache=True, nogil=True)
def refine_depths(
    images, live, camera, pattern, uv, host, intensity, weight, T, affine, huber, outlier, inverse_depth,
    information, seen,
):  # fmt: skip
    """Refine the inverse depths of single points over all keyframes that see them.

    Args:
        images: (S, H, W, 3) keyframes.
        live: (S,) bool rows of keyframes.
        camera, pattern, uv, host, intensity, weight: of the points, as of the search.
        T: (S, S, 4, 4) motion host to target at [host, target].
        affine: (S, S, 2) likewise.
        huber: residual beyond which it counts linearly.
        outlier: (S,) cost of a pattern beyond which it is not that surface, per keyframe.
        inverse_depth: (N,) changed.
        information: (N,) on it at the end.
        seen: (N, S) int8: 1 where the point looks alike, 0 where it does not, -1 where it is not seen.
    """
    state, trial, step = np.empty(1), np.empty(1), np.empty(1)
    H, gradient, trial_H, trial_gradient = np.empty((1, 1)), np.empty(1), np.empty((1, 1)), np.empty(1)
    L, rows = np.empty((1, 1)), whole_rows(np.int64(1))
    for i in range(uv.shape[0]):
        h = host[i]
        observed = (
            images, live, camera, pattern, uv[i], h, intensity[i], weight[i], T[h], affine[h], huber, outlier,
            seen[i],
        )  # fmt: skip
        state[0] = inverse_depth[i]
        cost = _depth_model(state, observed, H, gradient)
        problem = state, trial, observed, H, gradient, trial_H, trial_gradient, L, rows, step
        minimise(is_known, _propose, accept_trial, problem, cost, _STEPS, _DAMPING, _TOLERANCE)
        _depth_model(state, observed, H, gradient)
        inverse_depth[i], information[i] = state[0], H[0, 0]


@njit(inline="always")
def _propose(problem, damping):
    state, trial, observed, H, gradient, trial_H, trial_gradient, L, rows, step = problem
    predicted = damped_step(H, gradient, damping, L, rows, step)
    if predicted == np.inf:
        return np.inf, 0.0
    trial[0] = state[0] + step[0]
    if not trial[0] > 0.0:
        trial[0] = 0.5 * state[0]
    return _depth_model(trial, observed, trial_H, trial_gradient), predicted


@njit(inline="always")
def _depth_model(state, observed, H, gradient):
    """Cost of an inverse depth over all keyframes, with half of it as a quadratic form."""
    images, live, camera, pattern, uv, h, intensity, weight, T, affine, huber, outlier, seen = observed
    total, H[0, 0], gradient[0] = 0.0, 0.0, 0.0
    for s in range(images.shape[0]):
        seen[s] = -1
        if s == h or not live[s]:
            continue
        cost, a, b, seen[s] = _pattern_model(
            images[s], camera, uv[0], uv[1], state[0], pattern, intensity, weight, T[s],
            np.exp(affine[s, 0]), affine[s, 1], huber, max(outlier[h], outlier[s]),
        )  # fmt: skip
        total += cost
        H[0, 0] += a
        gradient[0] += b
    return total
