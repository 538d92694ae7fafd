"""Activation: points whose depth is certain enough become part of the window, spread over the image.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 3.2.
Where it says less, this follows the authors' public code step by step.
"""

import numpy as np

from dslab.slam.direct._alignment_kernels import PATTERN
from dslab.slam.ldso._activation_kernels import refine_depths, spread
from dslab.slam.ldso.config import ImmatureConfig, PhotometricConfig
from dslab.slam.ldso.points import Active, Immature
from dslab.slam.ldso.window import Window

_FIRST_SPACING_PX = 4.0
_MOST_SPACING_PX = 8.0
_COARSEST = 4.0  # factor of the spacing of points that stand out on the coarsest level only
# Share of the wanted points up to which the spacing is widened by so many pixels.
_FEWER = ((0.66, 1.6), (0.8, 1.0), (0.9, 0.4), (1.0, 0.2))


class Activator:
    """Chooses the points that are activated, so that the window has about as many as wanted, and no more.

    Attributes:
        spacing_px: least distance of a new point to others.
    """

    def __init__(self) -> None:
        self.spacing_px = _FIRST_SPACING_PX

    def activate(self, window: Window, config: ImmatureConfig, photometric: PhotometricConfig) -> int:
        """Activate points in a window that has got a new keyframe; the number of them.

        Those that are chosen but look alike nowhere are dropped, and so are hopeless ones.
        """
        self._adapt(len(window.active), window.config.points)
        immature = window.immature
        ripe = immature.is_ripe(config) & (immature.host != window.newest)
        rows = np.flatnonzero(ripe)
        rows = rows[self._are_spread(window, immature.of(rows))]
        room = max(0, window.config.points - len(window.active))
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(room, len(rows))).astype(int))]
        found, good = refined(window, immature.of(rows), config, photometric)
        window.active = window.active.with_more(found.of(good))
        gone = immature.is_hopeless
        gone[rows] = True
        dropped = gone.copy()
        dropped[rows[good]] = False
        np.add.at(window.gone, immature.host[dropped], 1)
        window.immature = immature.of(~gone)
        return int(good.sum())

    def _adapt(self, active: int, wanted: int) -> None:
        share = active / wanted
        change = next((-px for most, px in _FEWER if share < most), 0.0)
        if share > 1.0:
            change = next((px for most, px in _FEWER if 1.0 / share < most), 0.0)
        self.spacing_px = float(np.clip(self.spacing_px + change, 0.0, _MOST_SPACING_PX))

    def _are_spread(self, window: Window, candidates: Immature) -> np.ndarray:
        """(N,) bool: candidates that are away from active points and from each other in the newest view."""
        seen, _, _ = window.seen_from(window.newest)
        at = projected(window, candidates, candidates.inverse_depth)
        height, width = window.images.shape[1:3]
        inside = np.all((at > 2) & (at < [width - 3, height - 3]), axis=1)
        distance = self.spacing_px * 2.0 ** candidates.scale[inside]
        kept = np.zeros(int(inside.sum()), bool)
        size = max(1.0, _COARSEST * self.spacing_px)
        spread(seen, np.ascontiguousarray(at[inside]), distance, size, kept)
        inside[inside] = kept
        return inside


def projected(window: Window, points: Immature, inverse_depth: np.ndarray) -> np.ndarray:
    """(N, 2) pixels of the newest keyframe at which points (N rows) are; NaN behind it."""
    fx, fy, cx, cy = window.intrinsics[0]
    T = window.motions()[:, window.newest][points.host]
    rays = np.column_stack([(points.uv - [cx, cy]) / [fx, fy], np.ones(len(points))])
    X = np.einsum("nij,nj->ni", T[:, :3, :3], rays) + T[:, :3, 3] * inverse_depth[:, None]
    z = np.where(X[:, 2] > 1e-6, X[:, 2], np.nan)
    return X[:, :2] / z[:, None] * [fx, fy] + [cx, cy]


def refined(
    window: Window, points: Immature, config: ImmatureConfig, photometric: PhotometricConfig
) -> tuple[Active, np.ndarray]:
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
        config.iterations, inverse_depth, information, seen,
    )  # fmt: skip
    alike = (seen == 1).sum(axis=1)
    good = (alike > 0) & (information > config.least_information) & (inverse_depth > 0)
    seen[seen == 0] = -1
    found = Active(
        points.host, points.uv, points.intensity, points.weight, points.scale, inverse_depth, information,
        seen, alike,
    )  # fmt: skip
    return found, good
