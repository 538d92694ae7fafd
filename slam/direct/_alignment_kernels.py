"""Kernels of photometric alignment.

Names: a reference pixel with inverse depth d lies, seen from its camera, along the ray (x, y, 1) at depth
1/d. ``T`` takes reference camera to target camera. The residual of a pixel of a pattern is
target(u) - exp(a) reference - b.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 2.2 and 2.3.
"""

import numpy as np
from numba import njit

from dslab.slam.direct._outer_products import SIZE, add_outer_products
from dslab.slam.optimization._se3 import retract

PATTERN = np.array(
    [[0, -2], [-1, -1], [1, -1], [-2, 0], [0, 0], [2, 0], [-1, 1], [0, 2]], np.float64
)  # (8, 2) right, down
_ONE = np.uint64(1)
_BLOCK = 256  # pixels projected at once
_DEVIATIONS, _TO_SIGMA = 3.0, 1.4826
_OFF_PX = 0.5
_ENOUGH = 2000  # pixels, for a median


@njit(cache=True, nogil=True, inline="always")
def _bilinear(level, u, v, channel):
    x, y = np.int32(u), np.int32(v)
    fx, fy = u - x, v - y
    # Unsigned: Numba need not look whether they count from the end.
    left, top = np.uint64(x), np.uint64(y)
    right, below = left + _ONE, top + _ONE
    return (1.0 - fy) * ((1.0 - fx) * level[top, left, channel] + fx * level[top, right, channel]) + fy * (
        (1.0 - fx) * level[below, left, channel] + fx * level[below, right, channel]
    )


@njit(inline="always")
def _bilinear_all(level, u, v):
    """Intensity and both gradients of a level at a place."""
    x, y = np.int32(u), np.int32(v)
    fx, fy = u - x, v - y
    left, top = np.uint64(x), np.uint64(y)
    right, below = left + _ONE, top + _ONE
    a, b, c, d = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    return (
        a * level[top, left, 0]
        + b * level[top, right, 0]
        + c * level[below, left, 0]
        + d * level[below, right, 0],
        a * level[top, left, 1]
        + b * level[top, right, 1]
        + c * level[below, left, 1]
        + d * level[below, right, 1],
        a * level[top, left, 2]
        + b * level[top, right, 2]
        + c * level[below, left, 2]
        + d * level[below, right, 2],
    )


@njit(cache=True, nogil=True)
def sample_patterns(level, uv, pattern, gradient_scale, intensity, weight):
    """Write intensity and weight (N, 8) of the pattern about each pixel (N, 2); weight 0 outside the image.

    The weight is c²/(c² + gradient²), less where the gradient is large and small errors of place tell most.
    """
    height, width = level.shape[0], level.shape[1]
    c2 = gradient_scale * gradient_scale
    for i in range(uv.shape[0]):
        for k in range(pattern.shape[0]):
            u, v = uv[i, 0] + pattern[k, 0], uv[i, 1] + pattern[k, 1]
            intensity[i, k], weight[i, k] = 0.0, 0.0
            if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
                continue
            value = _bilinear(level, u, v, 0)
            gx, gy = _bilinear(level, u, v, 1), _bilinear(level, u, v, 2)
            square = gx * gx + gy * gy
            if square >= 0.0:  # not NaN
                intensity[i, k], weight[i, k] = value, c2 / (c2 + square)


@njit(cache=True, nogil=True, error_model="numpy")
def _project(camera, uv, inverse_depth, pattern, T, scale_x, scale_y, first, last, seen_x, seen_y, depth):
    """Write where pixels of points ``first`` to ``last`` are seen at depth one, scaled, and at what depth.

    It has no branches, so that it is vectorised; what is behind the camera means nothing.
    """
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    right, down = pattern[:, 0].copy(), pattern[:, 1].copy()
    T_00, T_01, T_02, T_03 = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    T_10, T_11, T_12, T_13 = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    T_20, T_21, T_22, T_23 = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    for i in range(first, last):
        u, v, d = uv[i, 0], uv[i, 1], inverse_depth[i]
        for k in range(np.uint64(len(right))):
            x = (u + right[k] - cx) / fx
            y = (v + down[k] - cy) / fy
            z = T_20 * x + T_21 * y + T_22 + T_23 * d
            at = np.uint64(len(right) * (i - first)) + k
            depth[at] = z
            seen_x[at] = scale_x * (T_00 * x + T_01 * y + T_02 + T_03 * d) / z
            seen_y[at] = scale_y * (T_10 * x + T_11 * y + T_12 + T_13 * d) / z


@njit(cache=True, nogil=True, error_model="numpy")
def residual_energy(level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, huber, cutoff):
    """Energy of an alignment.

    Returns:
        Sum of weighted Huber costs, in which a residual beyond ``cutoff`` counts as ``cutoff``; number of
        pixels compared; of these, beyond the cutoff.
    """
    right, bottom = level.shape[1] - 1.0, level.shape[0] - 1.0
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    gain, offset = np.exp(affine[0]), affine[1]
    most = huber * (2.0 * cutoff - huber) if cutoff > huber else cutoff * cutoff
    count = pattern.shape[0]
    points = _BLOCK // count
    seen_x, seen_y, depth = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    energy, seen, saturated = 0.0, 0, 0
    for i in range(uv.shape[0]):
        start = i % points
        if start == 0:
            last = min(i + points, uv.shape[0])
            _project(camera, uv, inverse_depth, pattern, T, fx, fy, i, last, seen_x, seen_y, depth)
        for k in range(count):
            at = count * start + k
            if weight[i, k] <= 0.0 or depth[at] <= 1e-6:
                continue
            u, v = seen_x[at] + cx, seen_y[at] + cy
            if not (0.0 <= u < right and 0.0 <= v < bottom):
                continue
            size = abs(_bilinear(level, u, v, 0) - gain * intensity[i, k] - offset)
            if size <= cutoff:
                energy += weight[i, k] * (size * size if size <= huber else huber * (2.0 * size - huber))
                seen += 1
            elif size > cutoff:  # not NaN
                energy += weight[i, k] * most
                seen += 1
                saturated += 1
    return energy, seen, saturated


@njit(cache=True, nogil=True, error_model="numpy")
def residual_bound(level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, least):
    """Residual beyond which a pixel shows another surface: three deviations, and at least ``least``.

    The deviation is 1.4826 times the median size, as of normal residuals, but not less than what an alignment
    leaves that is off by half a pixel in each direction, as one on a coarser level is: half of the root mean
    square gradient.
    """
    right, bottom = level.shape[1] - 1.0, level.shape[0] - 1.0
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    gain, offset = np.exp(affine[0]), affine[1]
    count = pattern.shape[0]
    stride = 1 + uv.shape[0] * count // _ENOUGH
    sizes, n, steep = np.empty(uv.shape[0] * count), 0, 0.0
    for i in range(0, uv.shape[0], stride):
        for k in range(count):
            if weight[i, k] <= 0.0:
                continue
            x, y = (uv[i, 0] + pattern[k, 0] - cx) / fx, (uv[i, 1] + pattern[k, 1] - cy) / fy
            z = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * inverse_depth[i]
            if not z > 1e-6:
                continue
            u = fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * inverse_depth[i]) / z + cx
            v = fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * inverse_depth[i]) / z + cy
            if not (0.0 <= u < right and 0.0 <= v < bottom):
                continue
            there, gx, gy = _bilinear_all(level, u, v)
            size = abs(there - gain * intensity[i, k] - offset)
            if size >= 0.0:  # not NaN
                sizes[n] = size
                n += 1
                steep += gx * gx + gy * gy if gx * gx + gy * gy >= 0.0 else 0.0
    if n == 0:
        return least
    off = _OFF_PX * np.sqrt(steep / n)
    return max(least, _DEVIATIONS * max(_TO_SIGMA * np.median(sizes[:n]), off))


@njit(cache=True, nogil=True, error_model="numpy")
def linearise(
    level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, huber, cutoff, H, gradient
):  # fmt: skip
    """Energy as of :func:`residual_energy`, with the Gauss-Newton model of half of it; residuals beyond
    ``cutoff`` are not in the model.

    Args:
        H, gradient: (8, 8) and (8,) by translation and rotation of a step ``T <- exp(twist) T``, a and b.
    """
    most = huber * (2.0 * cutoff - huber) if cutoff > huber else cutoff * cutoff
    energy, seen, saturated = 0.0, 0, 0
    right, bottom = level.shape[1] - 1.0, level.shape[0] - 1.0
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    gain, offset = np.exp(affine[0]), affine[1]
    count = pattern.shape[0]
    points = _BLOCK // count
    seen_x, seen_y, depth = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    J, weights, residuals = np.empty((_BLOCK, SIZE)), np.empty(_BLOCK), np.empty(_BLOCK)
    sums, rows = np.zeros((SIZE + 1, SIZE)), 0
    for i in range(uv.shape[0]):
        start = i % points
        if start == 0:
            add_outer_products(J, weights, residuals, rows, sums)
            rows, last = 0, min(i + points, uv.shape[0])
            _project(camera, uv, inverse_depth, pattern, T, 1.0, 1.0, i, last, seen_x, seen_y, depth)
        for k in range(count):
            at = count * start + k
            if weight[i, k] <= 0.0 or depth[at] <= 1e-6:
                continue
            px, py = seen_x[at], seen_y[at]
            u, v = fx * px + cx, fy * py + cy
            if not (0.0 <= u < right and 0.0 <= v < bottom):
                continue
            r = _bilinear(level, u, v, 0) - gain * intensity[i, k] - offset
            size = abs(r)
            if size > cutoff:
                energy += weight[i, k] * most
                seen += 1
                saturated += 1
                continue
            gx, gy = fx * _bilinear(level, u, v, 1), fy * _bilinear(level, u, v, 2)
            if not size + gx * gx + gy * gy >= 0.0:  # NaN
                continue
            energy += weight[i, k] * (size * size if size <= huber else huber * (2.0 * size - huber))
            seen += 1
            near = inverse_depth[i] / depth[at]  # inverse depth in the target
            along = gx * px + gy * py
            row = J[rows]
            row[0], row[1], row[2] = near * gx, near * gy, -near * along
            row[3], row[4], row[5] = -gy - py * along, gx + px * along, gy * px - gx * py
            row[6], row[7] = -gain * intensity[i, k], -1.0
            weights[rows] = weight[i, k] * (1.0 if size <= huber else huber / size)
            residuals[rows] = r
            rows += 1
    add_outer_products(J, weights, residuals, rows, sums)
    gradient[:] = sums[SIZE]
    for m in range(SIZE):
        for n in range(SIZE):
            H[m, n] = sums[min(m, n), max(m, n)]
    return energy, seen, saturated


@njit(cache=True, nogil=True)
def mean_costs(
    level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, huber, cutoff, prior, least
):  # fmt: skip
    """(S,) mean cost of a pixel with the prior of the brightness; infinite with fewer pixels than ``least``.

    Args:
        T, affine: (S, 4, 4) and (S, 2), of several alignments.
        prior: (2,) information on ``affine``.
    """
    costs = np.empty(len(T))
    for i in range(len(T)):
        energy, seen, _ = residual_energy(
            level, camera, uv, inverse_depth, pattern, intensity, weight, T[i], affine[i], huber, cutoff
        )
        costs[i] = _mean(energy, seen, affine[i], prior, least)
    return costs


@njit(cache=True, nogil=True)
def mean_cost_model(
    level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, huber, cutoff, prior, least,
    H, gradient,
):  # fmt: skip
    """Mean cost as of :func:`mean_costs`, with the Gauss-Newton model of half of its sum."""
    energy, seen, _ = linearise(
        level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, huber, cutoff, H, gradient
    )
    for m in range(2):
        H[6 + m, 6 + m] += prior[m]
        gradient[6 + m] += prior[m] * affine[m]
    return _mean(energy, seen, affine, prior, least)


@njit(cache=True, nogil=True)
def model_of_step(
    level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, step, huber, cutoff, prior,
    least, T_there, affine_there, H, gradient,
):  # fmt: skip
    """Mean cost and model after a step (8,); writes the alignment there, the last row of T_there excepted."""
    retract(T, step[:6], T_there)
    affine_there[:] = affine + step[6:]
    return mean_cost_model(
        level, camera, uv, inverse_depth, pattern, intensity, weight, T_there, affine_there, huber, cutoff,
        prior, least, H, gradient,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def advance(
    level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, solution, huber, cutoff, prior,
    least, scale, least_damping, least_information, still, progress, H, gradient, A, b,
):  # fmt: skip
    """Try a Levenberg step, keep it if the cost falls, and prepare the next one.

    Args:
        T, affine: (4, 4) and (2,), the alignment; moved by a step that is kept.
        solution: (8,) of the system, minus the step in units of ``scale``.
        scale: (8,) units of a step.
        least_damping, least_information: see :func:`damped_system`.
        still: a smaller step of translation and rotation is none.
        progress: (2,) cost and damping, written.
        H, gradient: model there, written with a step that is kept.
        A, b: (8, 8) and (8,) system of the next step, written.

    Returns:
        True at the end: the step was hardly any.
    """
    step = -solution
    T_there, affine_there = np.eye(4), np.empty(2)
    H_there, gradient_there = np.empty((SIZE, SIZE)), np.empty(SIZE)
    cost = model_of_step(
        level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, step * scale, huber, cutoff,
        prior, least, T_there, affine_there, H_there, gradient_there,
    )  # fmt: skip
    kept = cost < progress[0]
    if kept:
        T[:], affine[:], H[:], gradient[:] = T_there, affine_there, H_there, gradient_there
        progress[0] = cost
    if (np.abs(step[:6]) < still).all():
        return True
    progress[1] = max(progress[1] / 4, least_damping) if kept else 8 * progress[1]
    damped_system(H, gradient, scale, progress[1], least_information, A, b)
    return False


@njit(cache=True, nogil=True)
def damped_system(H, gradient, scale, damping, least, A, b):
    """Write the system (8, 8), (8,) of a damped step in units of ``scale`` (8,)."""
    for i in range(SIZE):
        for j in range(SIZE):
            A[i, j] = H[i, j] * scale[j] * scale[i]
        A[i, i] += damping * H[i, i] * (scale[i] * scale[i]) + least
        b[i] = gradient[i] * scale[i]


@njit(cache=True, nogil=True)
def _mean(energy, seen, affine, prior, least):
    # NumPy's product, to its last bit.
    return (energy + np.dot(prior, affine**2)) / seen if seen >= least else np.inf


@njit(cache=True, nogil=True)
def likeness(level, camera, uv, inverse_depth, pattern, intensity, weight, T):
    """Correlation of the two views within the patterns, -1 to 1, which no gain or shading can feign."""
    height, width = level.shape[0], level.shape[1]
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    count = pattern.shape[0]
    value = np.empty(count)
    both, own, others = 0.0, 0.0, 0.0
    for i in range(uv.shape[0]):
        d = inverse_depth[i]
        mean, other_mean, seen = 0.0, 0.0, True
        for k in range(count):
            x = (uv[i, 0] + pattern[k, 0] - cx) / fx
            y = (uv[i, 1] + pattern[k, 1] - cy) / fy
            pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * d
            if weight[i, k] <= 0.0 or pz <= 1e-6:
                seen = False
                break
            u = fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * d) / pz + cx
            v = fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * d) / pz + cy
            if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
                seen = False
                break
            value[k] = _bilinear(level, u, v, 0)
            mean += intensity[i, k] / count
            other_mean += value[k] / count
        if not seen or not other_mean >= 0.0:  # NaN
            continue
        for k in range(count):
            a, b = intensity[i, k] - mean, value[k] - other_mean
            both += a * b
            own += a * a
            others += b * b
    return both / np.sqrt(own * others) if own > 0.0 and others > 0.0 else 0.0
