"""Activation: points whose depth is known well enough become part of the window, spread over the image.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 3.2: points are kept apart in the newest
keyframe, and more so where they stand out on coarse levels only. Ours: by the width of a pattern, beyond
which residuals are independent. The paper takes the farthest ones, which lie at the border and leave it soon.
"""

import numpy as np

from dslab.slam.direct._alignment_kernels import PATTERN
from dslab.slam.ldso._activation_kernels import apart, refine_depths
from dslab.slam.ldso.config import PhotometricConfig
from dslab.slam.ldso.points import Active, Immature
from dslab.slam.ldso.window import Window

_PATTERN_PX = 4  # between the outer pixels of a pattern
_LEAST_INFORMATION = 100.0
"""Of a depth in units of the usual one, for residuals of unit variance: with residuals of four grey levels a
depth is known to two fifths of the usual one."""


def activate(window: Window, photometric: PhotometricConfig) -> int:
    """Activate points in a window that has got a new keyframe; the number of them.

    Those that are chosen but look alike nowhere are dropped, and so are hopeless ones.
    """
    immature = window.immature
    ripe = np.flatnonzero(immature.is_ripe & (immature.host != window.newest))
    rows = ripe[_apart(window, immature.of(ripe))]
    room = max(0, min(window.config.points - len(window.active), len(rows)))
    rows = rows[np.arange(room) * len(rows) // max(1, room)]
    found, good = refined(window, immature.of(rows), photometric)
    window.active = window.active.with_more(found.of(good))
    gone = immature.is_hopeless
    gone[rows] = True
    window.immature = immature.of(~gone)
    return int(good.sum())


def _apart(window: Window, candidates: Immature) -> np.ndarray:
    """(N,) bool: candidates that are apart from active points and each other in the newest keyframe."""
    height, width = window.images.shape[1:3]
    seen = np.floor(window.seen_from(window.newest)[0]).astype(int)
    seen = seen[np.all((seen >= 0) & (seen < [width, height]), axis=1)]
    taken = np.zeros((height, width), bool)
    taken[seen[:, 1], seen[:, 0]] = True
    at = projected(window, candidates, candidates.inverse_depth)
    kept = np.all((at > 2) & (at < [width - 3, height - 3]), axis=1)
    of_inside = np.zeros(int(kept.sum()), bool)
    distance = _PATTERN_PX << candidates.scale[kept].astype(np.int64)
    apart(np.ascontiguousarray(at[kept]), distance, taken, of_inside)
    kept[kept] = of_inside
    return kept


def projected(window: Window, points: Immature, inverse_depth: np.ndarray) -> np.ndarray:
    """(N, 2) pixels of the newest keyframe at which points (N rows) are; NaN behind it."""
    fx, fy, cx, cy = window.intrinsics[0]
    T = window.motions()[:, window.newest][points.host]
    rays = np.column_stack([(points.uv - [cx, cy]) / [fx, fy], np.ones(len(points))])
    X = np.einsum("nij,nj->ni", T[:, :3, :3], rays) + T[:, :3, 3] * inverse_depth[:, None]
    z = np.where(X[:, 2] > 1e-6, X[:, 2], np.nan)
    return X[:, :2] / z[:, None] * [fx, fy] + [cx, cy]


def refined(window: Window, points: Immature, photometric: PhotometricConfig) -> tuple[Active, np.ndarray]:
    """Refine depths over all keyframes of a window.

    Returns:
        The points with their residuals, and (N,) bool: it looks alike in a keyframe, and the depth is
        determined.
    """
    n = len(points)
    inverse_depth, information = points.inverse_depth.copy(), np.empty(n)
    seen = np.full((n, window.size), -1, np.int8)
    refine_depths(
        window.images, window.live, window.intrinsics[0], PATTERN, points.uv, points.host, points.intensity,
        points.weight, window.motions(), window.brightness(), photometric.huber, window.outlier,
        inverse_depth, information, seen,
    )  # fmt: skip
    alike = (seen == 1).sum(axis=1)
    usual = np.median(inverse_depth) if n else 1.0
    good = (alike > 0) & (information * usual**2 > _LEAST_INFORMATION) & (inverse_depth > 0)
    seen[seen == 0] = -1
    found = Active(
        points.host, points.uv, points.intensity, points.weight, points.scale, inverse_depth, information,
        seen, alike,
    )  # fmt: skip
    return found, good
