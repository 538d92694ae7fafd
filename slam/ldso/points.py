"""Points of keyframes: pixels with their patterns, and what is known of their inverse depths."""

from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from dslab.slam.direct._alignment_kernels import PATTERN, sample_patterns
from dslab.slam.direct._ray_kernels import look
from dslab.slam.direct.pyramid import ImagePyramid
from dslab.slam.direct.rays import DISTINCT, LEAST_NOISE, POSE_PX, RIPE_PX, unlike
from dslab.slam.ldso.config import PhotometricConfig

_TOLD = 1 / 16  # of the prior's variance: a quarter of its standard deviation


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


@dataclass
class Immature(Pixels):
    """Points whose depth is being searched; see :mod:`slam.direct.rays`.

    Attributes:
        unlike: (N,) what unlike patterns of the keyframe differ by, of 255.
        steep: (N,) mean squared gradient of each pattern over that of the keyframe's patterns.
        slope: (N,) root mean square gradient of these, grey levels per px.
        inverse_depth, variance: (N,) mean and variance.
        prior: (N,) variance before any look.
        floor: (N,) least variance by the poses of the views.
        right, wrong: (N,) int64 looks in which the surface was seen, and was not.
        deviation_px: (N,) standard deviation on the line of the last look.
        outside: (N,) bool: the last view does not show it.
    """

    unlike: np.ndarray
    steep: np.ndarray
    slope: np.ndarray
    inverse_depth: np.ndarray
    variance: np.ndarray
    prior: np.ndarray
    floor: np.ndarray
    right: np.ndarray
    wrong: np.ndarray
    deviation_px: np.ndarray
    outside: np.ndarray

    @classmethod
    def none(cls) -> Self:
        """No points."""
        uv, patterns = np.empty((0, 2)), np.empty((0, len(PATTERN)))
        hosts, scale = np.empty(0, np.int64), np.empty(0, np.int32)
        return cls._new(hosts, uv, patterns, patterns, scale, np.inf, np.empty(0), 1.0, 1.0)

    @classmethod
    def at(
        cls,
        pyramid: ImagePyramid,
        host: int,
        uv: np.ndarray,
        scale: np.ndarray,
        usual: float,
        photometric: PhotometricConfig,
    ) -> Self:
        """Given pixels (N, 2) of a keyframe; those whose pattern is not all known are left out.

        Args:
            pyramid, host: of the keyframe, and its row.
            uv, scale: pixels (N, 2), and (N,) levels on which their gradients stand out.
            usual: usual inverse depth: mean and standard deviation before any look.
            photometric: settings.
        """
        intensity, weight = patterns(pyramid, uv, photometric)
        known = (weight > 0).all(axis=1)
        hosts, scale = np.full(len(uv), host, np.int64), np.asarray(scale, np.int32)
        square = photometric.gradient_scale**2 * (1.0 / np.where(weight > 0, weight, np.nan) - 1.0)
        steep = square.mean(axis=1)
        mean = max(float(np.mean(steep[known])) if known.any() else 1.0, 1e-9)
        by = unlike(intensity[known])
        points = cls._new(hosts, uv, intensity, weight, scale, by, steep / mean, np.sqrt(mean), usual)
        return points.of(known)

    @classmethod
    def _new(
        cls,
        host: np.ndarray,
        uv: np.ndarray,
        intensity: np.ndarray,
        weight: np.ndarray,
        scale: np.ndarray,
        unlike_by: float,
        steep: np.ndarray,
        slope: float,
        usual: float,
    ) -> Self:
        n = len(host)
        return cls(
            host, uv, intensity, weight, scale, np.full(n, unlike_by), steep, np.full(n, slope),
            np.full(n, usual),
            np.full(n, usual**2), np.full(n, usual**2), np.full(n, np.inf), np.zeros(n, np.int64),
            np.zeros(n, np.int64), np.full(n, np.inf), np.zeros(n, bool),
        )  # fmt: skip

    @property
    def is_ripe(self) -> np.ndarray:
        """(N,) bool: the depth can be refined over all keyframes.

        It is likelier right than not, its views rather than its prior say it, and it is known to a pixel.
        """
        told = self.variance < _TOLD * self.prior
        return (self.right > self.wrong) & told & (self.deviation_px < RIPE_PX) & (self.inverse_depth > 0)

    @property
    def is_hopeless(self) -> np.ndarray:
        """(N,) bool: out of the last view, or likely wrong: an inlier with less than one in four."""
        return self.outside | (4 * (self.right + 1) < self.right + self.wrong + 2)

    def search(
        self,
        pyramid: ImagePyramid,
        intrinsics: np.ndarray,
        T: np.ndarray,
        affine: np.ndarray,
        noise: float,
        photometric: PhotometricConfig,
    ) -> None:
        """Look for all points along their rays in a view.

        Args:
            pyramid: of the view.
            intrinsics: (4,) of its finest level.
            T: (S, 4, 4) motion, keyframe to view.
            affine: (S, 2) brightness of the view relative to the keyframes.
            noise: standard deviation of its residuals, of 255.
            photometric: settings.
        """
        look(
            pyramid.levels[0], intrinsics, PATTERN, self.uv, self.host, self.intensity, self.weight,
            self.unlike, self.steep, self.slope, np.ascontiguousarray(T), np.ascontiguousarray(affine),
            photometric.huber,
            photometric.gradient_scale, noise, LEAST_NOISE, POSE_PX, DISTINCT, self.inverse_depth,
            self.variance, self.floor, self.right, self.wrong, self.deviation_px, self.outside,
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
