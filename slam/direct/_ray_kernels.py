"""Kernel of looks along rays; what it computes is derived in :mod:`slam.direct.rays`."""

import numpy as np
from numba import njit

from dslab.slam.direct._alignment_kernels import _bilinear_all

_REACH = 3.0  # standard deviations
_LONGEST_PX = 128  # of a line that is searched: it bounds the time, not what is believed
_MARGIN_PX = 4.0
_MOST_SCALE = 2.0  # of a pattern in the other view, either way
_STEPS = 3  # of the refinement
_STILL_PX = 0.03  # a smaller step changes nothing else: a third of the least error by a pose
_PATTERN_PX = 2.0  # half of the pattern's width: nearer places show the same


@njit(cache=True, nogil=True)
def look(
    level, camera, pattern, uv, host, intensity, weight, unlike, steep, slope, T, affine, huber,
    gradient_scale, noise, least_noise, pose_px, distinct, mean, variance, floor, right, wrong, deviation_px,
    outside,
):  # fmt: skip
    """Narrow inverse depths by a view.

    Args:
        level: (H, W, 3) of the view.
        camera: (4,) of it.
        pattern: (8, 2).
        uv: (N, 2) pixels of the hosts.
        host: (N,) row of each point's host.
        intensity, weight: (N, 8) of the patterns.
        unlike: (N,) what unlike patterns of the host differ by.
        steep: (N,) mean squared gradient of each pattern over that of the host's patterns.
        slope: (N,) root mean square gradient of the host's patterns.
        T: (S, 4, 4) motion, host to view.
        affine: (S, 2) brightness of the view relative to the hosts.
        huber: residual beyond which it counts linearly.
        gradient_scale: by which the weights were given.
        noise, least_noise: standard deviation of residuals in the frame, and without any gradient.
        pose_px: least standard deviation of the view's points by its pose, px.
        distinct: least likelihood of the best place over that of the best elsewhere.
        mean, variance, floor: (N,) of the inverse depths; changed.
        right, wrong: (N,) numbers of looks; changed.
        deviation_px: (N,) standard deviation on the line; written where the point is in view.
        outside: (N,) bool, written.
    """
    height, width = level.shape[0], level.shape[1]
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    count = pattern.shape[0]
    of_frame = max(noise * noise - least_noise * least_noise, 0.0)
    warped, expected, costs = np.empty((count, 2)), np.empty(count), np.empty(_LONGEST_PX + 4)
    plane = np.ascontiguousarray(level[:, :, 0]).ravel()
    for i in range(uv.shape[0]):
        h = host[i]
        variance_of_noise = least_noise * least_noise + of_frame * steep[i]
        bar = 2.0 * variance_of_noise * np.log(distinct)
        R, gain, offset = T[h], np.exp(affine[h, 0]), affine[h, 1]
        x, y = (uv[i, 0] - cx) / fx, (uv[i, 1] - cy) / fy
        px = R[0, 0] * x + R[0, 1] * y + R[0, 2]
        py = R[1, 0] * x + R[1, 1] * y + R[1, 2]
        pz = R[2, 0] * x + R[2, 1] * y + R[2, 2]
        tx, ty, tz = R[0, 3], R[1, 3], R[2, 3]
        z = pz + mean[i] * tz
        outside[i] = True
        if not 1.0 / _MOST_SCALE < z < _MOST_SCALE:
            continue
        a, b = (px + mean[i] * tx) / z, (py + mean[i] * ty) / z
        u0, v0 = fx * a + cx, fy * b + cy
        if not (_MARGIN_PX <= u0 < width - _MARGIN_PX and _MARGIN_PX <= v0 < height - _MARGIN_PX):
            continue
        outside[i] = False
        ex, ey = fx * (tx - a * tz) / z, fy * (ty - b * tz) / z
        rate = np.sqrt(ex * ex + ey * ey)  # px per inverse depth
        deviation = np.sqrt(variance[i])
        deviation_px[i] = rate * deviation
        if not rate > 1e-9:
            continue
        ex, ey = ex / rate, ey / rate
        first = _along(max(mean[i] - _REACH * deviation, 0.0), px, py, pz, tx, ty, tz, fx, fy, a, b, ex, ey)
        last = _along(mean[i] + _REACH * deviation, px, py, pz, tx, ty, tz, fx, fy, a, b, ex, ey)
        first = max(min(first, -1.0), -0.5 * _LONGEST_PX)
        last = min(max(last, 1.0), first + _LONGEST_PX)
        for k in range(count):
            r, s = pattern[k, 0] / fx, pattern[k, 1] / fy
            deeper = R[2, 0] * r + R[2, 1] * s
            warped[k, 0] = fx * (R[0, 0] * r + R[0, 1] * s - a * deeper) / z
            warped[k, 1] = fy * (R[1, 0] * r + R[1, 1] * s - b * deeper) / z
        steps, step = 1, 0.0
        if last - first > 2.0 * _PATTERN_PX:
            steps = int(np.ceil(last - first)) + 1
            step = (last - first) / (steps - 1)
        else:  # all of it shows the same: the refinement begins at the mean
            first = 0.0
        # The best place elsewhere may lie half a step off; its cost there is more by a quarter of eᵀGe,
        # which is no more than the sum of w g² = c² (1 - w) over the host's pattern.
        total = weight[i].sum()
        least = bar + 0.25 * (gain * gradient_scale) ** 2 * (count - total)
        for k in range(count):
            expected[k] = gain * intensity[i, k]
        _costs(
            plane, level.shape[1], u0, v0, ex, ey, first, step, warped, expected, weight[i], offset, huber,
            costs[:steps],
        )  # fmt: skip
        best, at = np.inf, -1
        for s in range(steps):
            if costs[s] < best:
                best, at = costs[s], s
        if at < 0:
            outside[i] = True
            continue
        place, best, H, cross = _refined(
            level, u0, v0, ex, ey, first + at * step, warped, expected, weight[i], offset, huber,
        )  # fmt: skip
        odds = total * (np.log(unlike[i]) - 0.5 * np.log(variance_of_noise))
        odds -= 0.5 * best * (1.0 / variance_of_noise - 1.0 / (unlike[i] * unlike[i]))
        if not (odds > 0.0 and H > 0.0):
            wrong[i] += 1
            continue
        off = max(of_frame / (slope[i] * slope[i]), pose_px * pose_px)
        by_noise, by_pose = least_noise * least_noise / H, off * (1.0 + (cross / H) ** 2)
        apart = max(_PATTERN_PX, _REACH * np.sqrt(by_noise + by_pose))
        clear = True
        for s in range(steps):
            if abs(first + s * step - place) > apart and costs[s] < best + least:
                other, cost, _, _ = _refined(
                    level, u0, v0, ex, ey, first + s * step, warped, expected, weight[i], offset, huber,
                )  # fmt: skip
                if cost < best + bar and abs(other - place) > apart:
                    clear = False
                    break
        if not clear:
            continue
        right[i] += 1
        # Inverse depth at that place, by the direction in which the line runs most.
        if abs(ex) > abs(ey):
            there = a + place * ex / fx
            found = (pz * there - px) / (tx - there * tz)
        else:
            there = b + place * ey / fy
            found = (pz * there - py) / (ty - there * tz)
        z = pz + found * tz
        if not 0.0 < z < np.inf:
            continue
        a, b = (px + found * tx) / z, (py + found * ty) / z
        rate = np.sqrt((fx * (tx - a * tz) / z) ** 2 + (fy * (ty - b * tz) / z) ** 2)
        if not rate > 1e-9:
            continue
        told = (by_noise + by_pose) / (rate * rate)
        share = variance[i] / (variance[i] + told)
        if not np.isfinite(floor[i]):  # before any look: the prior says where to search, not what is found
            if told > variance[i]:
                continue
            share = 1.0
        mean[i] = max(mean[i] + share * (found - mean[i]), 0.0)
        floor[i] = min(floor[i], by_pose / (rate * rate))
        variance[i] = max(share * told, floor[i])
        deviation_px[i] = rate * np.sqrt(variance[i])


@njit(cache=True, nogil=True, inline="always")
def _along(d, px, py, pz, tx, ty, tz, fx, fy, a, b, ex, ey):
    """Place of an inverse depth on the line through (a, b), px; what is behind the view is endlessly far."""
    z = pz + d * tz
    if z <= 1e-3:
        return np.inf
    return fx * ((px + d * tx) / z - a) * ex + fy * ((py + d * ty) / z - b) * ey


@njit(cache=True, nogil=True)
def _costs(plane, width, u, v, ex, ey, first, step, warped, expected, weight, offset, huber, costs):
    """Sums of the weighted Huber costs of a pattern at places on a line.

    Args:
        plane: (H W,) intensities of the view, of this width.
        u, v, ex, ey: pixel at nought, and unit vector along the line.
        first, step: places, px.
        warped, expected, weight: (K, 2), (K,), (K,) of the pattern in the view.
        offset: of the brightness; huber as in :func:`look`.
        costs: (S,) written; infinite out of the image.
    """
    right, bottom = width - 1.0, plane.shape[0] // width - 1.0
    begin, end = costs.shape[0], 0
    for s in range(costs.shape[0]):
        place, inside = first + s * step, True
        for k in range(warped.shape[0]):
            x, y = (u + place * ex) + warped[k, 0], (v + place * ey) + warped[k, 1]
            inside = inside and 0.0 <= x < right and 0.0 <= y < bottom
        costs[s] = 0.0 if inside else np.inf
        if inside:
            begin, end = min(begin, s), s + 1
    for k in range(warped.shape[0]):
        for s in range(begin, end):
            place = first + s * step
            x, y = (u + place * ex) + warped[k, 0], (v + place * ey) + warped[k, 1]
            left, top = np.int32(x), np.int32(y)
            fx, fy = x - left, y - top
            i = np.int64(top) * width + left
            a, b = plane[np.uint64(i)], plane[np.uint64(i + 1)]
            c, d = plane[np.uint64(i + width)], plane[np.uint64(i + width + 1)]
            there = (1.0 - fy) * ((1.0 - fx) * a + fx * b) + fy * ((1.0 - fx) * c + fx * d)
            r = abs(there - expected[k] - offset)
            within = min(r, huber)
            costs[s] += weight[k] * (within * (2.0 * r - within))


@njit(cache=True, nogil=True)
def _refined(level, u0, v0, ex, ey, place, warped, expected, weight, offset, huber):
    """Steps of Gauss and Newton along the line; the best place with its cost, eᵀGe and eᵀGn there."""
    best, H, cross = np.inf, 0.0, 0.0
    at = place
    right, bottom = level.shape[1] - 1.0, level.shape[0] - 1.0
    for _ in range(_STEPS + 1):
        cost, g, h, c = 0.0, 0.0, 0.0, 0.0
        for k in range(warped.shape[0]):
            x, y = u0 + at * ex + warped[k, 0], v0 + at * ey + warped[k, 1]
            if not (0.0 <= x < right and 0.0 <= y < bottom):
                return place, best, H, cross
            there, gx, gy = _bilinear_all(level, x, y)
            r = there - expected[k] - offset
            along, across = ex * gx + ey * gy, ex * gy - ey * gx
            size = abs(r)
            within = min(size, huber)
            cost += weight[k] * (within * (2.0 * size - within))
            w = weight[k] * (huber / max(size, huber))
            g += w * along * r
            h += w * along * along
            c += w * along * across
        if cost < best:
            place, best, H, cross = at, cost, h, c
        else:
            break
        if not h > 0.0:
            break
        move = min(max(g / h, -1.0), 1.0)
        at = place - move
        if abs(move) < _STILL_PX:
            return at, best, H, cross
    return place, best, H, cross
