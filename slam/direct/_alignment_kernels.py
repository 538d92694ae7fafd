"""Kernels of photometric alignment.

Names: a reference pixel with inverse depth d lies, seen from its camera, along the ray (x, y, 1) at depth
1/d. ``T`` takes reference camera to target camera. The residual of a pixel of a pattern is
target(u) - exp(a) reference - b.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 2.2 and 2.3.
"""

import numpy as np
from numba import njit

PATTERN = np.array(
    [[0, -2], [-1, -1], [1, -1], [-2, 0], [0, 0], [2, 0], [-1, 1], [0, 2]], np.float64
)  # (8, 2) right, down
_PARAMETERS = 8  # translation, rotation, a, b


@njit(cache=True, nogil=True, inline="always")
def _bilinear(level, u, v, channel):
    x, y = int(u), int(v)
    fx, fy = u - x, v - y
    return (1.0 - fy) * ((1.0 - fx) * level[y, x, channel] + fx * level[y, x + 1, channel]) + fy * (
        (1.0 - fx) * level[y + 1, x, channel] + fx * level[y + 1, x + 1, channel]
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


@njit(cache=True, nogil=True)
def residual_energy(level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, huber, cutoff):
    """Energy of an alignment.

    Returns:
        Sum of weighted Huber costs, in which a residual beyond ``cutoff`` counts as ``cutoff``; number of
        pixels compared; of these, beyond the cutoff.
    """
    height, width = level.shape[0], level.shape[1]
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    gain, offset = np.exp(affine[0]), affine[1]
    most = huber * (2.0 * cutoff - huber) if cutoff > huber else cutoff * cutoff
    energy, seen, saturated = 0.0, 0, 0
    for i in range(uv.shape[0]):
        d = inverse_depth[i]
        for k in range(pattern.shape[0]):
            if weight[i, k] <= 0.0:
                continue
            x = (uv[i, 0] + pattern[k, 0] - cx) / fx
            y = (uv[i, 1] + pattern[k, 1] - cy) / fy
            pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * d
            if pz <= 1e-6:
                continue
            u = fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * d) / pz + cx
            v = fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * d) / pz + cy
            if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
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


@njit(cache=True, nogil=True)
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
    height, width = level.shape[0], level.shape[1]
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    gain, offset = np.exp(affine[0]), affine[1]
    H[:], gradient[:] = 0.0, 0.0
    J = np.empty(_PARAMETERS)
    for i in range(uv.shape[0]):
        d = inverse_depth[i]
        for k in range(pattern.shape[0]):
            if weight[i, k] <= 0.0:
                continue
            x = (uv[i, 0] + pattern[k, 0] - cx) / fx
            y = (uv[i, 1] + pattern[k, 1] - cy) / fy
            pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * d
            if pz <= 1e-6:
                continue
            px = (T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * d) / pz
            py = (T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * d) / pz
            u, v = fx * px + cx, fy * py + cy
            if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
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
            near = d / pz  # inverse depth in the target
            along = gx * px + gy * py
            J[0], J[1], J[2] = near * gx, near * gy, -near * along
            J[3] = -gy - py * along
            J[4] = gx + px * along
            J[5] = gy * px - gx * py
            J[6], J[7] = -gain * intensity[i, k], -1.0
            w = weight[i, k] * (1.0 if size <= huber else huber / size)
            for m in range(_PARAMETERS):
                wj = w * J[m]
                gradient[m] += wj * r
                for n in range(m, _PARAMETERS):
                    H[m, n] += wj * J[n]
    for m in range(_PARAMETERS):
        for n in range(m):
            H[m, n] = H[n, m]
    return energy, seen, saturated


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
