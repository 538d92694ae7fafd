"""Tracking of frames against the projected points of the newest keyframe, coarse to fine.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 3.1.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from dslab.slam.direct._alignment_kernels import PATTERN, residual_bound, sample_patterns
from dslab.slam.direct.pyramid import ImagePyramid
from dslab.slam.ldso._reference_kernels import gather, halved_sums, splat
from dslab.slam.ldso._tracking_kernels import mean_squared_flow, refine, typical_likeness
from dslab.slam.ldso.config import DirectTrackingConfig, KeyframeConfig, PhotometricConfig

_ONE_PIXEL = np.zeros((1, 2))
_MARGIN_PX = 3
SURE = 0.9
"""Likeness with which no other guess is tried: noise has a tenth of the contrast's variance."""
_STILL_PX = 0.05  # a smaller step is none
_LEAST_PIXELS = 50
_GRADIENT_SCALE = 50.0
_PATCHES = 500  # by which likeness is judged


@dataclass(frozen=True)
class LevelPixels:
    """Pixels of known depth on one level of a keyframe.

    Attributes:
        uv: (N, 2) float64 pixels of the level.
        inverse_depth: (N,) float64.
        intensity, weight: (N, 1) float64.
    """

    uv: np.ndarray
    inverse_depth: np.ndarray
    intensity: np.ndarray
    weight: np.ndarray

    def seen_by(self, intrinsics: np.ndarray, T: np.ndarray) -> np.ndarray:
        """(N, 2) where a camera sees them, by its (4, 4) motion from the keyframe; NaN behind it."""
        f, c = intrinsics[:2], intrinsics[2:]
        rays = np.column_stack([(self.uv - c) / f, np.ones(len(self.uv))])
        X = rays @ T[:3, :3].T + T[:3, 3] * self.inverse_depth[:, None]
        X[X[:, 2] <= 1e-6] = np.nan
        return X[:, :2] / X[:, 2:] * f + c


class TrackingReference:
    """A keyframe with the points projected into it, for every level of its pyramid.

    Args:
        pyramid: of the keyframe.
        intrinsics: (L, 4) of its levels.
        uv: (N, 2) pixels of the finest level where points are seen.
        inverse_depth: (N,) theirs, in the keyframe.
        weight: (N,) how much each counts where several share a pixel.

    Attributes:
        levels: pixels of every level.
        patches: some pixels of the finest level with the pattern about each.
        depth: usual depth.
    """

    def __init__(
        self,
        pyramid: ImagePyramid,
        intrinsics: np.ndarray,
        uv: np.ndarray,
        inverse_depth: np.ndarray,
        weight: np.ndarray,
    ) -> None:
        self.intrinsics = intrinsics
        shape = pyramid.levels[0].shape[:2]
        total, mass = np.zeros(shape), np.zeros(shape)
        splat(np.ascontiguousarray(uv, float), inverse_depth, weight, total, mass)
        levels = []
        for number, level in enumerate(pyramid.levels):
            if number:
                total, mass = halved_sums(total), halved_sums(mass)
            levels.append(_pixels(total, mass, level))
        self.levels = tuple(levels)
        self.patches = _patches(levels[0], pyramid.levels[0])
        self.depth = 1.0 / float(np.median(inverse_depth)) if len(inverse_depth) else 1.0

    def residuals(
        self, pyramid: ImagePyramid, T_frame_ref: np.ndarray, affine: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compare a frame with the keyframe on the finest level.

        Args:
            pyramid: of the frame.
            T_frame_ref: (4, 4) its motion from the keyframe.
            affine: (2,) its brightness relative to the keyframe's.

        Returns:
            (N, 2) pixels of the frame and (N,) differences of intensity, where both are known.
        """
        finest = self.levels[0]
        uv = finest.seen_by(self.intrinsics[0], T_frame_ref)
        known = np.isfinite(uv).all(axis=1)
        seen = map_coordinates(pyramid.levels[0][..., 0], uv[known, ::-1].T, order=1, cval=np.nan)
        residual = seen - np.exp(affine[0]) * finest.intensity[known, 0] - affine[1]
        inside = np.isfinite(residual)
        return uv[known][inside], residual[inside]


@dataclass(frozen=True)
class Expected:
    """Where a frame is expected.

    Attributes:
        T_frame_ref: (4, 4) motion from the keyframe.
        information: (6, 6) on a motion from there, translations in usual depths.
        variance: of a pixel's residuals as far as they count for this.
    """

    T_frame_ref: np.ndarray
    information: np.ndarray
    variance: float


_ANYWHERE = Expected(np.eye(4), np.zeros((6, 6)), 1.0)


@dataclass(frozen=True)
class Tracked:
    """Motion of a frame relative to a keyframe.

    Attributes:
        T_frame_ref: (4, 4) motion, keyframe's camera to frame's.
        affine: (2,) its brightness relative to the keyframe's.
        error: root of the mean Huber cost of a pixel on the finest level, of 255.
        visible: share of the keyframe's pixels that the frame shows.
        saturated: share of these whose residual is beyond their bound.
        likeness: median correlation of the views within a pattern, -1 to 1, which no brightness can feign.
        flow_px: root of the mean squared motion of the pixels by the translation alone, and by all of it.
        information: (6, 6) of the images on the motion, brightness taken out, translations in usual depths,
            for residuals of unit variance.
    """

    T_frame_ref: np.ndarray
    affine: np.ndarray
    error: float
    visible: float
    saturated: float
    likeness: float
    flow_px: tuple[float, float]
    information: np.ndarray

    def demand(self, width: int, height: int, config: KeyframeConfig) -> float:
        """How much the view has changed: a keyframe is wanted beyond 1."""
        alone, whole = self.flow_px
        unit = (640 + 480) / (width + height)
        return (config.translation * alone + config.whole * whole) * unit + config.brightness * abs(
            float(self.affine[0])
        )


class PhotometricTracker:
    """Aligns frames with a reference.

    Args:
        photometric, config: settings.
    """

    def __init__(self, photometric: PhotometricConfig, config: DirectTrackingConfig) -> None:
        self.config = config
        self._photometric = photometric
        self._prior = np.array(photometric.affine_prior)

    def track(
        self,
        reference: TrackingReference,
        pyramid: ImagePyramid,
        guesses: Iterable[np.ndarray],
        affine: np.ndarray,
        usual_likeness: float,
        exposure: float = 0.0,
        expected: Expected = _ANYWHERE,
    ) -> Tracked | None:
        """Align a frame, coarse to fine, from one guess after another until one explains the image.

        Args:
            reference: the keyframe.
            pyramid: of the frame.
            guesses: (4, 4) motions, keyframe to frame, the likeliest first.
            affine: (2,) brightness at first.
            usual_likeness: with which a result is taken without trying other guesses.
            exposure: logarithm of the frame's exposure over the keyframe's, by which a is expected.
            expected: where the frame is.

        Returns:
            The best alignment; None if the views have too little in common.
        """
        best = None
        for T in guesses:
            found = self._align(reference, pyramid, T, affine, exposure, expected)
            if found is not None and (best is None or _badness(found) < _badness(best)):
                best = found
            if best is not None and best.likeness >= usual_likeness:
                break
        return best

    def _align(
        self,
        reference: TrackingReference,
        pyramid: ImagePyramid,
        guess: np.ndarray,
        affine: np.ndarray,
        exposure: float,
        expected: Expected,
    ) -> Tracked | None:
        config, huber = self.config, self._photometric.huber
        T, affine = np.array(guess, float), np.array(affine, float)
        affine[0] -= exposure  # of the keyframe as it would be with the frame's exposure
        exposed = float(np.exp(exposure))
        cost, seen, saturated, H = np.inf, 0, 0, np.zeros((8, 8))
        for number in range(len(pyramid) - 1, -1, -1):
            p, camera = reference.levels[number], reference.intrinsics[number]
            if len(p.uv) < _LEAST_PIXELS:
                continue
            level = pyramid.levels[number]
            intensity = p.intensity if exposed == 1.0 else exposed * p.intensity
            pixels = p.uv, p.inverse_depth, _ONE_PIXEL, intensity, p.weight
            cutoff = residual_bound(level, camera, *pixels, T, affine, huber)
            cost, seen, saturated = refine(
                level, camera, *pixels, T, affine, self._prior, expected.T_frame_ref, expected.information,
                expected.variance, huber, cutoff, config.iterations, reference.depth,
                _STILL_PX / camera[0], H,
            )  # fmt: skip
        finest = reference.levels[0]
        if seen < _LEAST_PIXELS or not np.isfinite(T).all():
            return None
        some = reference.patches
        alike = typical_likeness(
            pyramid.levels[0], reference.intrinsics[0], some.uv, some.inverse_depth, PATTERN, some.intensity,
            some.weight, T,
        )  # fmt: skip
        alone, whole = mean_squared_flow(reference.intrinsics[0], finest.uv, finest.inverse_depth, T)
        affine[0] += exposure
        return Tracked(
            T,
            affine,
            float(np.sqrt(cost)),
            seen / len(finest.uv),
            saturated / seen,
            float(alike),
            (float(np.sqrt(alone)), float(np.sqrt(whole))),
            _of_images(H),
        )


def _of_images(H: np.ndarray) -> np.ndarray:
    """(6, 6) what images say of a motion, by their information (8, 8) on it and on the brightness."""
    brightness = H[6:, 6:] + 1e-9 * np.eye(2)
    by_images = H[:6, :6] - H[:6, 6:] @ np.linalg.solve(brightness, H[6:, :6])
    values, vectors = np.linalg.eigh(0.5 * (by_images + by_images.T))
    return vectors * np.maximum(values, 0.0) @ vectors.T


def _badness(found: Tracked) -> float:
    """How unlike the views are; an alignment that looks away from most of the points is worse."""
    return (1.0 - found.likeness) / max(found.visible, 1e-3)


def _pixels(total: np.ndarray, mass: np.ndarray, level: np.ndarray) -> LevelPixels:
    most = total.size
    uv, inverse_depth, intensity = np.empty((most, 2)), np.empty(most), np.empty(most)
    n = gather(total, mass, level, _MARGIN_PX, uv, inverse_depth, intensity)
    return LevelPixels(uv[:n].copy(), inverse_depth[:n].copy(), intensity[:n, None].copy(), np.ones((n, 1)))


def _patches(pixels: LevelPixels, level: np.ndarray) -> LevelPixels:
    """Some of the pixels of a level, evenly chosen, with the pattern about each, (N, 8)."""
    rows = np.unique(np.linspace(0, len(pixels.uv) - 1, min(_PATCHES, len(pixels.uv))).astype(int))
    uv = np.ascontiguousarray(pixels.uv[rows])
    intensity, weight = np.empty((len(uv), len(PATTERN))), np.empty((len(uv), len(PATTERN)))
    sample_patterns(level, uv, PATTERN, _GRADIENT_SCALE, intensity, weight)
    return LevelPixels(uv, pixels.inverse_depth[rows], intensity, weight)
