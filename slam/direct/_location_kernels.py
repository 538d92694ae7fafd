"""Kernels that locate single points of a reference in another view, whose motion is known."""

import numpy as np
from numba import njit

from dslab.slam.direct._alignment_kernels import _bilinear

_STEPS = 4  # of the refinement
_MOST_SHIFT_PX = 2.0
_DAMPING = 0.05  # of the larger direction: a point on an edge does not slide along it


@njit(cache=True, nogil=True)
def locate(level, camera, uv, inverse_depth, pattern, intensity, weight, T, affine, xy, error):
    """Write where points of known depth are seen, refined across their edges, and how well they fit.

    Args:
        xy: (N, 2) pixels of the target; NaN if not seen.
        error: (N,) weighted mean of the absolute residuals there.
    """
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    gain, offset = np.exp(affine[0]), affine[1]
    offsets = np.empty((pattern.shape[0], 2))
    for i in range(uv.shape[0]):
        xy[i, 0], xy[i, 1], error[i] = np.nan, np.nan, np.inf
        d = inverse_depth[i]
        u0, v0, seen = 0.0, 0.0, True
        # The pattern as the target sees it, about the point itself.
        for k in range(-1, pattern.shape[0]):
            du = pattern[k, 0] if k >= 0 else 0.0
            dv = pattern[k, 1] if k >= 0 else 0.0
            x, y = (uv[i, 0] + du - cx) / fx, (uv[i, 1] + dv - cy) / fy
            pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * d
            if pz <= 1e-6:
                seen = False
                break
            u = fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * d) / pz + cx
            v = fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * d) / pz + cy
            if k < 0:
                u0, v0 = u, v
            else:
                offsets[k, 0], offsets[k, 1] = u - u0, v - v0
        if seen:
            _refine(level, u0, v0, offsets, intensity[i], weight[i], gain, offset, i, xy, error)


@njit(cache=True, nogil=True)
def _refine(level, u0, v0, offsets, intensity, weight, gain, offset, i, xy, error):
    """Shift a pattern to where it fits best near (u0, v0)."""
    u, v = u0, v0
    for _ in range(_STEPS):
        gxx, gxy, gyy, bx, by = 0.0, 0.0, 0.0, 0.0, 0.0
        cost, total = 0.0, 0.0
        for k in range(offsets.shape[0]):
            if weight[k] <= 0.0:
                continue
            pu, pv = u + offsets[k, 0], v + offsets[k, 1]
            if not (0.0 <= pu < level.shape[1] - 1 and 0.0 <= pv < level.shape[0] - 1):
                return
            r = _bilinear(level, pu, pv, 0) - gain * intensity[k] - offset
            gx, gy = _bilinear(level, pu, pv, 1), _bilinear(level, pu, pv, 2)
            if not abs(r) + gx * gx + gy * gy >= 0.0:
                return
            gxx += weight[k] * gx * gx
            gxy += weight[k] * gx * gy
            gyy += weight[k] * gy * gy
            bx += weight[k] * gx * r
            by += weight[k] * gy * r
            cost += weight[k] * abs(r)
            total += weight[k]
        if total <= 0.0:
            return
        if cost / total < error[i]:
            xy[i, 0], xy[i, 1], error[i] = u, v, cost / total
        damped = _DAMPING * (gxx + gyy) + 1e-9
        a, c = gxx + damped, gyy + damped
        det = a * c - gxy * gxy
        u -= (c * bx - gxy * by) / det
        v -= (a * by - gxy * bx) / det
        if (u - u0) ** 2 + (v - v0) ** 2 > _MOST_SHIFT_PX**2:
            return


@njit(cache=True, nogil=True)
def search_line(
    level, camera, uv, pattern, intensity, weight, T, affine, nearest, farthest, most_px, most_error,
    distinct, xy, error,
):  # fmt: skip
    """Write where points of unknown depth are seen, searched along their epipolar lines.

    Args:
        nearest, farthest: inverse depths between which the line is searched.
        most_px: most pixels searched along a line.
        most_error: mean absolute residual beyond which nothing is found.
        distinct: next best residual, three pixels and more away, over the best, below which nothing is.
    """
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    gain, offset = np.exp(affine[0]), affine[1]
    height, width = level.shape[0], level.shape[1]
    costs = np.empty(int(most_px) + 2)
    for i in range(uv.shape[0]):
        xy[i, 0], xy[i, 1], error[i] = np.nan, np.nan, np.inf
        x, y = (uv[i, 0] - cx) / fx, (uv[i, 1] - cy) / fy
        qx = T[0, 0] * x + T[0, 1] * y + T[0, 2]
        qy = T[1, 0] * x + T[1, 1] * y + T[1, 2]
        qz = T[2, 0] * x + T[2, 1] * y + T[2, 2]
        far_z, near_z = qz + farthest * T[2, 3], qz + nearest * T[2, 3]
        if far_z <= 1e-6 or near_z <= 1e-6:
            continue
        u1 = fx * (qx + farthest * T[0, 3]) / far_z + cx
        v1 = fy * (qy + farthest * T[1, 3]) / far_z + cy
        u2 = fx * (qx + nearest * T[0, 3]) / near_z + cx
        v2 = fy * (qy + nearest * T[1, 3]) / near_z + cy
        length = np.sqrt((u2 - u1) ** 2 + (v2 - v1) ** 2)
        if length < 1.0 or length > most_px:
            continue
        steps = int(length) + 1
        best, at = np.inf, -1
        for s in range(steps + 1):
            u, v = u1 + (u2 - u1) * s / steps, v1 + (v2 - v1) * s / steps
            cost, total = 0.0, 0.0
            for k in range(pattern.shape[0]):
                pu, pv = u + pattern[k, 0], v + pattern[k, 1]
                if weight[i, k] <= 0.0 or not (0.0 <= pu < width - 1 and 0.0 <= pv < height - 1):
                    total = -1.0
                    break
                cost += weight[i, k] * abs(_bilinear(level, pu, pv, 0) - gain * intensity[i, k] - offset)
                total += weight[i, k]
            costs[s] = cost / total if total > 0.0 and cost >= 0.0 else np.inf
            if costs[s] < best:
                best, at = costs[s], s
        if at < 0 or best > 2.0 * most_error:
            continue
        second = np.inf
        for s in range(steps + 1):
            if abs(s - at) >= 3 and costs[s] < second:
                second = costs[s]
        if second < distinct * best:
            continue
        u, v = u1 + (u2 - u1) * at / steps, v1 + (v2 - v1) * at / steps
        _refine(level, u, v, pattern, intensity[i], weight[i], gain, offset, i, xy, error)
        if error[i] > most_error:
            xy[i, 0], xy[i, 1] = np.nan, np.nan
