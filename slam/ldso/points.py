"""Points of keyframes: pixels with their patterns, and what is known of their inverse depths.

Their states follow the public code of the authors of "Direct Sparse Odometry".
"""

from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from dslab.slam.direct._alignment_kernels import PATTERN, sample_patterns
from dslab.slam.direct.pyramid import ImagePyramid
from dslab.slam.ldso._epipolar_kernels import ALONG_EDGE, CERTAIN, GOOD, NEW, OUTLIER, OUTSIDE, search
from dslab.slam.ldso.config import ImmatureConfig, PhotometricConfig


@dataclass
class Pixels:
    """Pixels of keyframes, N rows.

    Attributes:
        host: (N,) int64 row of the keyframe in the window.
        uv: (N, 2) float64 pixel there.
        intensity, weight: (N, 8) float64 of the pattern about it.
        scale: (N,) int32 level of the pyramid on which its gradient stands out.
    """

    host: np.ndarray
    uv: np.ndarray
    intensity: np.ndarray
    weight: np.ndarray
    scale: np.ndarray

    def __len__(self) -> int:
        return len(self.host)

    def of(self, rows: np.ndarray) -> Self:
        """The rows (indices or mask) alone, copied."""
        return type(self)(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def with_more(self, more: Self) -> Self:
        """These, then more."""
        return type(self)(
            **{f.name: np.concatenate([getattr(self, f.name), getattr(more, f.name)]) for f in fields(self)}
        )

    def moved(
        self, pyramids: dict[int, ImagePyramid], uv: np.ndarray, photometric: PhotometricConfig
    ) -> Self:
        """The points at other pixels, in other images of their keyframes.

        Args:
            pyramids: of the keyframes, by row.
            uv: (N, 2) pixels.
            photometric: settings.

        Returns:
            Those whose pattern is known there.
        """
        points, known = self.of(np.arange(len(self))), np.zeros(len(self), bool)
        points.uv = uv
        for host in np.unique(self.host):
            rows = self.host == host
            points.intensity[rows], points.weight[rows] = patterns(pyramids[int(host)], uv[rows], photometric)
            known[rows] = (points.weight[rows] > 0).all(axis=1)
        return points.of(known)


def patterns(
    pyramid: ImagePyramid, uv: np.ndarray, photometric: PhotometricConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Intensity and weight (N, 8) of the patterns about pixels (N, 2); weight 0 where they are not known."""
    intensity, weight = np.empty((len(uv), len(PATTERN))), np.empty((len(uv), len(PATTERN)))
    sample_patterns(pyramid.levels[0], uv, PATTERN, photometric.gradient_scale, intensity, weight)
    return intensity, weight


def _structure(pyramid: ImagePyramid, uv: np.ndarray) -> np.ndarray:
    """(N, 3) sums of gx², gx gy, gy² over the patterns about pixels (N, 2)."""
    level = pyramid.levels[0]
    cells = np.rint(uv[:, None] + PATTERN).astype(int)
    y = np.clip(cells[..., 1], 0, level.shape[0] - 1)
    gradient = level[y, np.clip(cells[..., 0], 0, level.shape[1] - 1), 1:].astype(float)
    gx, gy = gradient[..., 0], gradient[..., 1]
    return np.stack([(gx * gx).sum(1), (gx * gy).sum(1), (gy * gy).sum(1)], axis=1)


@dataclass
class Immature(Pixels):
    """Points whose depth is being searched.

    Attributes:
        structure: (N, 3) sums of gx², gx gy, gy² over the pattern.
        far, near: (N,) interval of inverse depth; ``near`` is infinite where nothing is known.
        quality: (N,) cost of the second best place over that of the best, least of the searches.
        status: (N,) int64 outcome of the last search.
        interval_px: (N,) length of the interval on the line of the last search, px.
    """

    structure: np.ndarray
    far: np.ndarray
    near: np.ndarray
    quality: np.ndarray
    status: np.ndarray
    interval_px: np.ndarray

    @classmethod
    def none(cls) -> Self:
        """No points."""
        return cls(
            np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, len(PATTERN))), np.empty((0, len(PATTERN))),
            np.empty(0, np.int32), np.empty((0, 3)), np.empty(0), np.empty(0), np.empty(0),
            np.empty(0, np.int64), np.empty(0),
        )  # fmt: skip

    @classmethod
    def at(
        cls,
        pyramid: ImagePyramid,
        host: int,
        uv: np.ndarray,
        scale: np.ndarray,
        photometric: PhotometricConfig,
    ) -> Self:
        """Given pixels (N, 2) of a keyframe; those whose pattern is not all known are left out."""
        n = len(uv)
        intensity, weight = patterns(pyramid, uv, photometric)
        structure = _structure(pyramid, uv)
        known = (weight > 0).all(axis=1) & np.isfinite(structure).all(axis=1)
        return cls(
            np.full(n, host, np.int64), uv, intensity, weight, np.asarray(scale, np.int32), structure,
            np.zeros(n), np.full(n, np.inf), np.full(n, 1e4), np.full(n, NEW, np.int64),
            np.full(n, np.inf),
        ).of(known)  # fmt: skip

    def moved(
        self, pyramids: dict[int, ImagePyramid], uv: np.ndarray, photometric: PhotometricConfig
    ) -> "Immature":
        """See :meth:`Pixels.moved`."""
        points = super().moved(pyramids, uv, photometric)
        for host in np.unique(points.host):
            rows = points.host == host
            points.structure[rows] = _structure(pyramids[int(host)], points.uv[rows])
        return points.of(np.isfinite(points.structure).all(axis=1))

    @property
    def inverse_depth(self) -> np.ndarray:
        """(N,) middle of the intervals."""
        return 0.5 * (self.far + self.near)

    def is_ripe(self, config: ImmatureConfig) -> np.ndarray:
        """(N,) bool: the depth is certain enough to be refined over all keyframes."""
        good = np.isin(self.status, (GOOD, CERTAIN, ALONG_EDGE))
        certain = (self.interval_px < config.activated_px) & np.isfinite(self.near) & (self.near > 0)
        return good & certain & (self.quality > config.quality)

    @property
    def is_hopeless(self) -> np.ndarray:
        """(N,) bool: out of the image, or never found."""
        return np.isin(self.status, (OUTSIDE, OUTLIER))

    def search(
        self,
        pyramid: ImagePyramid,
        intrinsics: np.ndarray,
        T: np.ndarray,
        affine: np.ndarray,
        usual: float,
        config: ImmatureConfig,
        photometric: PhotometricConfig,
    ) -> None:
        """Search all points along their epipolar lines in a view.

        Args:
            pyramid: of the view.
            intrinsics: (4,) of its finest level.
            T: (S, 4, 4) motion, keyframe to view.
            affine: (S, 2) brightness of the view relative to the keyframes.
            usual: usual inverse depth.
            config, photometric: settings.
        """
        level = pyramid.levels[0]
        search(
            level, intrinsics, PATTERN, self.uv, self.host, self.intensity, self.weight, self.structure,
            np.ascontiguousarray(T), np.ascontiguousarray(affine), usual,
            config.most_share * (level.shape[0] + level.shape[1]), config.nearest, config.longest,
            config.certain_px, config.error_px,
            config.slope_error_px, config.most_error_px, config.second_px, config.outlier, config.slack,
            photometric.huber, self.near, self.far, self.quality, self.status, self.interval_px,
        )  # fmt: skip


@dataclass
class Active(Pixels):
    """Points of the window, with residuals in S keyframes.

    Attributes:
        inverse_depth: (N,) float64.
        information: (N,) on it, for residuals of unit variance.
        seen: (N, S) int8: 1 where the point looks alike, 0 where it does not, -1 without a residual.
        observed: (N,) number of keyframes in which it was ever found alike.
    """

    inverse_depth: np.ndarray
    information: np.ndarray
    seen: np.ndarray
    observed: np.ndarray

    @classmethod
    def none(cls, slots: int) -> Self:
        """No points."""
        return cls(
            np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, len(PATTERN))), np.empty((0, len(PATTERN))),
            np.empty(0, np.int32), np.empty(0), np.empty(0), np.empty((0, slots), np.int8),
            np.empty(0, np.int64),
        )  # fmt: skip
