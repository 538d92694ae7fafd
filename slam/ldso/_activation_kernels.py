"""Kernels of activation: which points are spread best, and their inverse depths over all keyframes.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 3.2.
Where it says less, ``refine_depths`` follows the authors' public code step by step.
"""

import numpy as np
from numba import njit

from dslab.slam.direct._alignment_kernels import _bilinear

_DAMPING = 0.1
_MOST_DAMPING = 1e3


@njit(cache=True, nogil=True)
def spread(active, candidates, distance, size, kept):
    """Keep candidates that are away from active points and from those kept before them.

    Args:
        active: (M, 2) pixels of active points; any place.
        candidates: (N, 2) pixels.
        distance: (N,) least distance of each, px.
        size: side of a cell of the search, px: at least the largest distance.
        kept: (N,) bool to write to.
    """
    n, m = candidates.shape[0], active.shape[0]
    kept[:] = False
    if n == 0:
        return
    x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
    for i in range(n):
        x0, x1 = min(x0, candidates[i, 0]), max(x1, candidates[i, 0])
        y0, y1 = min(y0, candidates[i, 1]), max(y1, candidates[i, 1])
    columns, rows = int((x1 - x0) / size) + 1, int((y1 - y0) / size) + 1
    head = np.full(columns * rows, -1, np.int64)
    following = np.full(n + m, -1, np.int64)
    place = np.empty((n + m, 2))
    for j in range(m + n):
        i = j - m
        u, v = (active[j, 0], active[j, 1]) if i < 0 else (candidates[i, 0], candidates[i, 1])
        # Points about the candidates' box count too, in the nearest cell; farther ones can be near none.
        if not (x0 - size <= u <= x1 + size and y0 - size <= v <= y1 + size):
            continue
        c = min(max(int(np.floor((u - x0) / size)), 0), columns - 1)
        r = min(max(int(np.floor((v - y0) / size)), 0), rows - 1)
        free = True
        if i >= 0:
            square = distance[i] * distance[i]
            for rr in range(max(0, r - 1), min(rows, r + 2)):
                for cc in range(max(0, c - 1), min(columns, c + 2)):
                    k = head[rr * columns + cc]
                    while k >= 0 and free:
                        if (place[k, 0] - u) ** 2 + (place[k, 1] - v) ** 2 < square:
                            free = False
                        k = following[k]
            kept[i] = free
        if free:
            place[j, 0], place[j, 1] = u, v
            following[j] = head[r * columns + c]
            head[r * columns + c] = j


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
    images, live, camera, pattern, uv, host, intensity, weight, T, affine, huber, outlier, iterations,
    inverse_depth, information, seen,
):  # fmt: skip
    """Gauss-Newton steps on the inverse depth of single points over all keyframes that see them.

    Args:
        images: (S, H, W, 3) keyframes.
        live: (S,) bool rows of keyframes.
        camera, pattern, uv, host, intensity, weight: of the points, as of the search.
        T: (S, S, 4, 4) motion host to target at [host, target].
        affine: (S, S, 2) likewise.
        huber: residual beyond which it counts linearly.
        outlier: (S,) cost of a pattern beyond which it is not that surface, per keyframe.
        iterations: most steps.
        inverse_depth: (N,) changed.
        information: (N,) on it at the end.
        seen: (N, S) int8: 1 where the point looks alike, 0 where it does not, -1 where it is not seen.
    """
    S = images.shape[0]
    row = np.empty(S, np.int8)
    for i in range(uv.shape[0]):
        h, d = host[i], inverse_depth[i]
        energy, H, g = 0.0, 0.0, 0.0
        damping = _DAMPING
        for step in range(iterations + 1):
            there = d if step == 0 else d - g / (H * (1.0 + damping) + 1e-9)
            if not there > 0.0:
                there = 0.5 * d
            e2, H2, g2 = 0.0, 0.0, 0.0
            for s in range(S):
                row[s] = -1
                if s == h or not live[s]:
                    continue
                bound = max(outlier[h], outlier[s])
                e, a, b, row[s] = _pattern_model(
                    images[s], camera, uv[i, 0], uv[i, 1], there, pattern, intensity[i], weight[i], T[h, s],
                    np.exp(affine[h, s, 0]), affine[h, s, 1], huber, bound,
                )  # fmt: skip
                e2, H2, g2 = e2 + e, H2 + a, g2 + b
            if step == 0 or e2 < energy:
                still = step > 0 and abs(there - d) < 1e-4 * d
                d, energy, H, g = there, e2, H2, g2
                damping *= 0.5
                seen[i] = row
                if still:
                    break
            else:
                damping *= 5.0
                if damping > _MOST_DAMPING:
                    break
        inverse_depth[i], information[i] = d, H
