"""Kernel that narrows the inverse depths of points by a search along their epipolar lines.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 3.2.
Where it says less, the search follows the authors' public code step by step.
"""

import numpy as np
from numba import njit

from dslab.slam.direct._alignment_kernels import _bilinear

GOOD, OUTSIDE, OUTLIER, CERTAIN, ALONG_EDGE, NEW = 0, 1, 2, 3, 4, 5
"""Outcomes of the last search: found; out of the image; nothing alike; the interval is short already; the
line runs along the edge, so that nothing can be gained; not searched yet."""
_STEPS = 3  # of the refinement
_MOST_STEP_PX = 1.0
_FAR = 1e-2  # inverse depth that shows the direction of a line, of the usual one
_LEAST_SCALE, _MOST_SCALE = 0.75, 1.5  # of the pattern in the view
_LONG_SEARCH = 10  # places, beyond which a search replaces the quality


@njit(cache=True, nogil=True)
def search(
    level, camera, pattern, uv, host, intensity, weight, structure, T, affine, usual, most_px, nearest,
    longest, certain_px, error_px, slope_error_px, most_error_px, second_px, outlier, slack, huber, near, far,
    quality, status, interval_px,
):  # fmt: skip
    """Search points along their epipolar lines in a view, and narrow their intervals of inverse depth.

    Args:
        level: (H, W, 3) of the view.
        camera: (4,) of it.
        pattern: (8, 2).
        uv: (N, 2) pixels of the hosts.
        host: (N,) row of each point's host.
        intensity, weight: (N, 8) of the patterns.
        structure: (N, 3) sums of gx², gx gy, gy² over the pattern in the host.
        T: (S, 4, 4) motion, host to view.
        affine: (S, 2) brightness of the view relative to the hosts.
        usual: usual inverse depth.
        most_px, nearest, longest, certain_px, error_px, slope_error_px, most_error_px, second_px, outlier,
            slack, huber: as of ``ImmatureConfig``; ``most_px`` is the longest search of a known interval.
        near, far: (N,) inverse depths of the interval, ``near`` infinite where unknown; changed.
        quality, status, interval_px: (N,) changed.
    """
    height, width = level.shape[0], level.shape[1]
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    count = pattern.shape[0]
    warped = np.empty((count, 2))
    first_px = max(1.0, longest) * most_px
    costs = np.empty(int(first_px) + 8)
    for i in range(uv.shape[0]):
        if status[i] == OUTSIDE:
            continue
        h = host[i]
        R, gain, offset = T[h], np.exp(affine[h, 0]), affine[h, 1]
        x, y = (uv[i, 0] - cx) / fx, (uv[i, 1] - cy) / fy
        px = R[0, 0] * x + R[0, 1] * y + R[0, 2]
        py = R[1, 0] * x + R[1, 1] * y + R[1, 2]
        pz = R[2, 0] * x + R[2, 1] * y + R[2, 2]
        tx, ty, tz = R[0, 3], R[1, 3], R[2, 3]
        far_z = pz + far[i] * tz
        if far_z < _LEAST_SCALE or far_z > _MOST_SCALE:
            status[i] = OUTSIDE
            continue
        u1, v1 = fx * (px + far[i] * tx) / far_z + cx, fy * (py + far[i] * ty) / far_z + cy
        if not (4.0 <= u1 < width - 5 and 4.0 <= v1 < height - 5):
            status[i] = OUTSIDE
            continue
        known = near[i] < np.inf
        d2 = near[i] if known else far[i] + _FAR * usual
        near_z = pz + d2 * tz
        if near_z <= 1e-6:
            status[i] = OUTSIDE
            continue
        u2, v2 = fx * (px + d2 * tx) / near_z + cx, fy * (py + d2 * ty) / near_z + cy
        length = np.sqrt((u2 - u1) ** 2 + (v2 - v1) ** 2)
        if not length > 1e-9:
            status[i] = CERTAIN if known else ALONG_EDGE
            continue
        ex, ey = (u2 - u1) / length, (v2 - v1) / length
        if known:
            if length < certain_px:
                interval_px[i], status[i] = length, CERTAIN
                continue
            if not (4.0 <= u2 < width - 5 and 4.0 <= v2 < height - 5):
                status[i] = OUTSIDE
                continue
            length = min(length, most_px)
        else:
            # A camera that moves far shifts near points by more than the usual search.
            d3 = far[i] + nearest * usual
            z3 = pz + d3 * tz
            if z3 > 1e-6:
                u3, v3 = fx * (px + d3 * tx) / z3 + cx, fy * (py + d3 * ty) / z3 + cy
                length = np.sqrt((u3 - u1) ** 2 + (v3 - v1) ** 2)
            else:
                length = np.inf
            length = min(max(length, most_px), first_px)
        along = ex * ex * structure[i, 0] + 2.0 * ex * ey * structure[i, 1] + ey * ey * structure[i, 2]
        across = ey * ey * structure[i, 0] - 2.0 * ex * ey * structure[i, 1] + ex * ex * structure[i, 2]
        error = error_px + slope_error_px * (along + across) / max(along, 1e-9)
        if known and 2.0 * error > length:
            interval_px[i], status[i] = length, ALONG_EDGE
            continue
        error = min(error, most_error_px)
        # The pattern as it is turned by the rotation.
        for k in range(count):
            a, b = pattern[k, 0] / fx, pattern[k, 1] / fy
            warped[k, 0] = fx * (R[0, 0] * a + R[0, 1] * b)
            warped[k, 1] = fy * (R[1, 0] * a + R[1, 1] * b)
        steps = int(length + 1.9999)
        step = length / (steps - 1) if steps > 1 else 0.0
        best, at = np.inf, -1
        for s in range(steps):
            costs[s] = _cost(
                level, u1 + s * step * ex, v1 + s * step * ey, warped, intensity[i], weight[i], gain, offset,
                huber,
            )  # fmt: skip
            if costs[s] < best:
                best, at = costs[s], s
        if at < 0:
            status[i] = OUTSIDE
            continue
        second = np.inf
        for s in range(steps):
            if abs(s - at) * step > second_px and costs[s] < second:
                second = costs[s]
        found = second / max(best, 1e-9)
        if found < quality[i] or steps > _LONG_SEARCH:
            quality[i] = found
        place, best = _refined(
            level, u1, v1, ex, ey, at * step, best, warped, intensity[i], weight[i], gain, offset, huber
        )
        if not best <= slack * slack * outlier * outlier:
            status[i] = OUTLIER if status[i] != OUTLIER else OUTSIDE
            continue
        u, v = u1 + place * ex, v1 + place * ey
        if ex * ex > ey * ey:
            q = px * fx + pz * cx
            w = tx * fx + tz * cx
            low, high = u - error * ex, u + error * ex
        else:
            q = py * fy + pz * cy
            w = ty * fy + tz * cy
            low, high = v - error * ey, v + error * ey
        d_low, d_high = (pz * low - q) / (w - tz * low), (pz * high - q) / (w - tz * high)
        if d_low > d_high:
            d_low, d_high = d_high, d_low
        if not (d_high > 0.0 and d_high < np.inf and d_low > -np.inf):
            status[i] = OUTLIER if status[i] != OUTLIER else OUTSIDE
            continue
        far[i], near[i] = max(d_low, 0.0), d_high
        interval_px[i], status[i] = 2.0 * error, GOOD


@njit(cache=True, nogil=True)
def _cost(level, u, v, warped, intensity, weight, gain, offset, huber):
    """Mean weighted Huber cost of a pattern at a place; infinite out of the image."""
    cost, total = 0.0, 0.0
    for k in range(warped.shape[0]):
        a, b = u + warped[k, 0], v + warped[k, 1]
        if weight[k] <= 0.0 or not (0.0 <= a < level.shape[1] - 1 and 0.0 <= b < level.shape[0] - 1):
            return np.inf
        r = abs(_bilinear(level, a, b, 0) - gain * intensity[k] - offset)
        cost += weight[k] * (r * r if r <= huber else huber * (2.0 * r - huber))
        total += weight[k]
    return cost / total if cost >= 0.0 else np.inf


@njit(cache=True, nogil=True)
def _refined(level, u0, v0, ex, ey, place, best, warped, intensity, weight, gain, offset, huber):
    """Place along a line, in px from (u0, v0), by Gauss-Newton steps, and the cost there."""
    at = place
    back = 1.0
    for _ in range(_STEPS):
        H, g = 1e-9, 0.0
        for k in range(warped.shape[0]):
            a, b = u0 + at * ex + warped[k, 0], v0 + at * ey + warped[k, 1]
            if not (0.0 <= a < level.shape[1] - 1 and 0.0 <= b < level.shape[0] - 1):
                return place, best
            r = _bilinear(level, a, b, 0) - gain * intensity[k] - offset
            slope = ex * _bilinear(level, a, b, 1) + ey * _bilinear(level, a, b, 2)
            if not abs(slope) < np.inf:
                return place, best
            w = weight[k] * (1.0 if abs(r) <= huber else huber / abs(r))
            H += w * slope * slope
            g += w * slope * r
        move = -back * g / H
        at += min(max(move, -_MOST_STEP_PX), _MOST_STEP_PX)
        cost = _cost(level, u0 + at * ex, v0 + at * ey, warped, intensity, weight, gain, offset, huber)
        if cost < best:
            place, best = at, cost
        else:
            at = place
            back *= 0.5
        if abs(move) < 0.01:
            break
    return place, best
