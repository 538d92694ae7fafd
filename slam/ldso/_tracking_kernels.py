"""Kernels of the tracker: an image against the projected points of a keyframe.

Names as in :mod:`slam.direct._alignment_kernels`.
"""

import numpy as np
from numba import njit

from dslab.slam.direct._alignment_kernels import likeness, linearise
from dslab.slam.optimization._cholesky import whole_rows
from dslab.slam.optimization._se3 import retract
from dslab.slam.optimization.least_squares import damped_step, is_known, minimise

_DAMPING = 1e-2
_TOLERANCE = 1e-4  # share of the cost
_LEAST_PIXELS = 8  # as many as unknowns
_TAIL = 4.0  # degrees of freedom, by hand: the fewest with which variance and kurtosis are not both endless


@njit(cache=True, nogil=True)
def refine(
    level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, prior, expected, motion_prior,
    variance, huber, cutoff, iterations, depth, still, H,
):  # fmt: skip
    """Levenberg-Marquardt on one level.

    Args:
        level, camera, uv, inverse_depth, pattern, intensity, weight, huber, cutoff: as of ``linearise``.
        T, affine: (4, 4) and (2,) to begin with; changed in place.
        prior: (2,) information on a and b.
        expected: (4, 4) where the frame is expected.
        motion_prior: (6, 6) information on a motion from there, translations in usual depths; a hand that
            holds a camera jerks, so that it is that of Student's t with ``_TAIL`` degrees of freedom.
        variance: of a pixel's residuals as far as they count for this.
        iterations: most steps that are tried.
        depth: usual depth, the unit of steps of position.
        still: largest step, in rad and depths, that is none.
        H: (8, 8) information of the images and the prior of brightness at the end, written; translations in
            usual depths.

    Returns:
        Mean cost of a pixel; number of pixels compared; of these, beyond the cutoff.
    """
    priors = prior, np.linalg.inv(expected), motion_prior, variance
    observed = level, camera, uv, inverse_depth, pattern, intensity, weight, priors, huber, cutoff, depth
    gradient, counts = np.empty(8), np.zeros(2, np.int64)
    trial_counts = np.zeros(2, np.int64)
    cost = _model(T, affine, observed, H, gradient, counts)
    if not cost < np.inf:
        return np.inf, counts[0], counts[1]
    trial = T.copy(), affine.copy(), np.empty((8, 8)), np.empty(8), trial_counts
    room = np.empty((8, 8)), whole_rows(np.int64(8)), np.empty(8)
    problem = (T, affine, H, gradient, counts), trial, observed, room, still
    cost, _ = minimise(is_known, _propose, _accept, problem, cost, iterations, _DAMPING, _TOLERANCE)
    H *= counts[0]
    H[:6, :6] -= _pulled(T, priors, depth)[2] * motion_prior
    return cost, counts[0], counts[1]


@njit(inline="always")
def _model(T, affine, observed, H, gradient, counts):
    """Mean cost of a pixel with the prior; half of it as a quadratic form, positions in usual depths."""
    level, camera, uv, inverse_depth, pattern, intensity, weight, priors, huber, cutoff, depth = observed
    prior, _, motion_prior, _ = priors
    energy, counts[0], counts[1] = linearise(
        level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, huber, cutoff, H, gradient
    )
    n = counts[0]
    if n < _LEAST_PIXELS:
        return np.inf
    for k in range(2):
        H[6 + k, 6 + k] += prior[k]
        gradient[6 + k] += prior[k] * affine[k]
    for k in range(8):
        unit = depth if k < 3 else 1.0
        gradient[k] *= unit / n
        for m in range(8):
            H[k, m] *= unit / n
            H[m, k] *= unit
    pull, pulled, weight_of_it = _pulled(T, priors, depth)
    gradient[:6] += pull / n
    H[:6, :6] += weight_of_it * motion_prior / n
    return (energy + pulled + prior[0] * affine[0] ** 2 + prior[1] * affine[1] ** 2) / n


@njit(inline="always")
def _pulled(T, priors, depth):
    """Gradient (6,) of half the cost of being where a frame is not expected, that cost, and its weight."""
    _, from_expected, motion_prior, variance = priors
    twist = _small_twist(T @ from_expected)
    twist[:3] /= depth
    pull = motion_prior @ twist
    square = np.dot(pull, twist)
    weight = variance * (_TAIL + 6.0) / (_TAIL + square)
    return weight * pull, variance * (_TAIL + 6.0) * np.log1p(square / _TAIL), weight


@njit(cache=True, nogil=True)
def _small_twist(T):
    """(6,) twist of a motion, its translation to the first order of the rotation."""
    twist = np.empty(6)
    sine = 0.5 * np.array([T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]])
    size = np.sqrt(np.dot(sine, sine))
    angle = np.arctan2(size, 0.5 * (T[0, 0] + T[1, 1] + T[2, 2] - 1.0))
    twist[3:] = sine * (angle / size if size > 1e-9 else 1.0)
    t = T[:3, 3]
    twist[0] = t[0] - 0.5 * (twist[4] * t[2] - twist[5] * t[1])
    twist[1] = t[1] - 0.5 * (twist[5] * t[0] - twist[3] * t[2])
    twist[2] = t[2] - 0.5 * (twist[3] * t[1] - twist[4] * t[0])
    return twist


@njit(inline="always")
def _propose(problem, damping):
    (T, affine, H, gradient, _), trial, observed, (L, rows, step), _ = problem
    there, affine_there, trial_H, trial_gradient, trial_counts = trial
    predicted = damped_step(H, gradient, damping, L, rows, step)
    if predicted == np.inf:
        return np.inf, 0.0
    depth = observed[10]
    retract(T, step[:6] * np.array([depth, depth, depth, 1.0, 1.0, 1.0]), there)
    affine_there[0], affine_there[1] = affine[0] + step[6], affine[1] + step[7]
    return _model(there, affine_there, observed, trial_H, trial_gradient, trial_counts), predicted


@njit(inline="always")
def _accept(problem):
    (T, affine, H, gradient, counts), trial, _, (_, _, step), still = problem
    T[:], affine[:], H[:], gradient[:], counts[:] = trial[0], trial[1], trial[2], trial[3], trial[4]
    return np.abs(step[:6]).max() < still


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


@njit(cache=True, nogil=True)
def typical_likeness(level, camera, uv, inverse_depth, pattern, intensity, weight, T):
    """Median correlation of the two views within a pattern, -1 to 1; 0 where none is in view.

    A pattern counts by its contrast, of which the noise takes less; the median, as edges of other surfaces
    have the most.
    """
    n, count = uv.shape[0], pattern.shape[0]
    values, weights, k = np.empty(n), np.empty(n), 0
    for i in range(n):
        own = likeness(
            level, camera, uv[i : i + 1], inverse_depth[i : i + 1], pattern, intensity[i : i + 1],
            weight[i : i + 1], T,
        )  # fmt: skip
        mean, square = 0.0, 0.0
        for m in range(count):
            mean += intensity[i, m] / count
            square += intensity[i, m] * intensity[i, m] / count
        if own != 0.0:
            values[k], weights[k] = own, np.sqrt(max(square - mean * mean, 0.0))
            k += 1
    if k == 0:
        return 0.0
    order = np.argsort(values[:k])
    half, total = 0.5 * weights[:k].sum(), 0.0
    for i in order:
        total += weights[i]
        if total >= half:
            return values[i]
    return values[order[-1]]
