"""ORB features spread over the image: FAST corners on a pyramid, rotated BRIEF descriptors."""

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from dslab.slam.core.frame import Features
from dslab.slam.core.settings import GREY, setting, settings
from dslab.slam.features._fast_kernels import corner_contrast, refine_corners, select_corners
from dslab.slam.features._orb_kernels import BORDER_PX, descriptors, orientations
from dslab.slam.features._spread_kernels import spread_corners
from dslab.slam.features.faint import Amplifier
from dslab.slam.features.remembered import Remembered

# The blur of OpenCV's ORB: rounding differs from cv2.GaussianBlur at some pixels; it takes half the time.
_BLUR = cv2.getGaussianKernel(7, 2)


@settings
class OrbConfig:
    """Settings of the extractor."""

    n_features: int = setting(1000, "most features per image", ge=1)
    n_levels: int = setting(8, "levels of the pyramid", ge=1, le=32)
    scale_factor: float = setting(1.2, "ratio of the sizes of neighbouring levels", gt=1, le=4)
    fast_threshold: int = setting(20, "contrast that a corner must exceed", unit=GREY, ge=1, le=254)
    fast_min_threshold: int = setting(
        7, "contrast that a corner must exceed in cells where none exceeds fast_threshold", unit=GREY, ge=1
    )
    cell_px: int = setting(30, "side of the cells, in pixels of each level", ge=4)
    subpixel: bool = setting(True, "find corners between pixels; false: at whole ones, as in ORB-SLAM")
    noise_px: float = setting(
        0.5,
        "standard deviation of a corner, on which bounds of errors rest; ORB-SLAM's is 1",
        gt=0,
        le=10,
    )
    faint_share: float = setting(
        1.0, "share of n_features that faint corners make up; 0: none, as in ORB-SLAM", le=1
    )

    def __post_init__(self) -> None:
        if self.fast_min_threshold > self.fast_threshold:
            raise ValueError("fast_min_threshold is above fast_threshold, lower it")

    @cached_property
    def scales(self) -> np.ndarray:
        """(n_levels,) float64 nominal scale: image pixels per pixel of each level."""
        return self.scale_factor ** np.arange(self.n_levels)


@dataclass(frozen=True)
class _Level:
    image: np.ndarray  # (h, w) uint8
    blurred: np.ndarray  # (h, w) uint8
    contrast: np.ndarray  # (h * w,) uint8
    occupied: np.ndarray  # (rows, columns) bool: cells in which there are corners
    xs: np.ndarray  # candidate corners
    ys: np.ndarray
    contrasts: np.ndarray
    pixel: np.ndarray = field(repr=False)  # (2,) float64: image pixels per pixel, x and y


class OrbExtractor:
    """Extracts ORB features from images of one size.

    An instance owns its buffers: use one per thread. Returned features are never overwritten.
    """

    def __init__(
        self,
        width_px: int,
        height_px: int,
        config: OrbConfig | None = None,
        remembered: Remembered[Features] | None = None,
    ) -> None:
        """Allocate the buffers.

        Args:
            width_px: width of the images.
            height_px: height of the images.
            config: defaults to ``OrbConfig()``.
            remembered: features of earlier images, found by an extractor like this one; None for none.

        Raises:
            ValueError: the image is too small to hold the neighbourhood of one feature.
        """
        least = 2 * BORDER_PX + 1
        if width_px < least or height_px < least:
            raise ValueError(
                f"image of {width_px}x{height_px} px is too small for ORB: least is {least}x{least}"
            )
        self.config = config or OrbConfig()
        self.remembered = remembered
        self._shape = (height_px, width_px)
        self._levels = [self._allocate(scale) for scale in self.config.scales]
        self._amplifier: Amplifier | None = None  # most images need none
        self._faint_levels: list[_Level] = []

    def __deepcopy__(self, memo: dict) -> "OrbExtractor":
        """Return a new extractor with the same settings: buffers keep no state between images."""
        return OrbExtractor(self._shape[1], self._shape[0], self.config, self.remembered)

    def _allocate(self, scale: float) -> _Level:
        height, width = (max(round(size / scale), 1) for size in self._shape)
        # Of each 2x2 block at most one pixel is a local maximum.
        most = ((height + 1) // 2) * ((width + 1) // 2)
        return _Level(
            image=np.zeros((height, width), np.uint8),
            blurred=np.zeros((height, width), np.uint8),
            contrast=np.zeros(height * width, np.uint8),
            occupied=np.zeros(
                [max((size - 2 * BORDER_PX) // self.config.cell_px, 1) for size in (height, width)], np.bool_
            ),
            xs=np.empty(most, np.int32),
            ys=np.empty(most, np.int32),
            contrasts=np.empty(most, np.uint8),
            pixel=np.array([self._shape[1] / width, self._shape[0] / height]),
        )

    def extract(self, image: np.ndarray) -> Features:
        """Extract the features of an image; few or none if it has few corners.

        Args:
            image: (height_px, width_px) uint8.

        Raises:
            ValueError: the image has another shape or type.
        """
        self._check(image)
        return self._found(image) if self.remembered is None else self.remembered.of(image, self._found)

    def _found(self, image: np.ndarray) -> Features:
        config = self.config
        self._build_pyramid(image)
        for level in self._levels:
            level.occupied[:] = False
        n_corners = [self._detect(level, config.fast_threshold) for level in self._levels]
        parts = self._chosen(self._levels, n_corners, config.n_features)
        missing = round(config.faint_share * config.n_features) - sum(n_corners)
        if missing > 0:
            faint = self._faint(image, missing)
            parts = [part for octave in zip(parts, faint, strict=True) for part in octave]
        return Features(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def _chosen(self, levels: list[_Level], n_corners: list[int], most: int) -> list[tuple[np.ndarray, ...]]:
        """Choose among the corners of each level, and describe them."""
        quotas = share_out(most, self.config.scale_factor, n_corners)
        return [
            self._describe(octave, level, n, quota)
            for octave, (level, n, quota) in enumerate(zip(levels, n_corners, quotas, strict=True))
        ]

    def _faint(self, image: np.ndarray, most: int) -> list[tuple[np.ndarray, ...]]:
        """Corners of the amplified image in cells where the image itself has none."""
        if self._amplifier is None:
            self._faint_levels = [self._allocate(scale) for scale in self.config.scales]
            self._amplifier = Amplifier([level.image.shape for level in self._levels])
        least = self.config.fast_min_threshold
        self._amplifier.amplify(image, least, [level.image for level in self._faint_levels])
        found = []
        for level, faint in zip(self._levels, self._faint_levels, strict=True):
            np.copyto(faint.occupied, level.occupied)
            found.append(self._detect(faint, least))
        return self._chosen(self._faint_levels, found, most)

    def _check(self, image: np.ndarray) -> None:
        if not isinstance(image, np.ndarray) or image.dtype != np.uint8:
            raise ValueError(
                f"image must be a uint8 array, is {getattr(image, 'dtype', type(image).__name__)}"
            )
        if image.shape != self._shape:
            raise ValueError(f"image must have shape {self._shape}, has {image.shape}")

    def _build_pyramid(self, image: np.ndarray) -> None:
        np.copyto(self._levels[0].image, image)
        for finer, coarser in zip(self._levels, self._levels[1:], strict=False):
            height, width = coarser.image.shape
            cv2.resize(finer.image, (width, height), dst=coarser.image, interpolation=cv2.INTER_LINEAR)

    def _detect(self, level: _Level, threshold: int) -> int:
        height, width = level.image.shape
        corner_contrast(level.image, BORDER_PX - 1, level.contrast)
        return select_corners(
            level.contrast,
            height,
            width,
            BORDER_PX,
            np.uint8(threshold),
            np.uint8(self.config.fast_min_threshold),
            level.occupied,
            level.xs,
            level.ys,
            level.contrasts,
        )

    def _describe(self, octave: int, level: _Level, n_corners: int, quota: int) -> tuple[np.ndarray, ...]:
        height, width = level.image.shape
        xs, ys, contrasts = level.xs[:n_corners], level.ys[:n_corners], level.contrasts[:n_corners]
        chosen = spread_corners(xs, ys, contrasts, height, width, quota)
        xs, ys, contrasts = xs[chosen], ys[chosen], contrasts[chosen]
        if len(chosen):
            cv2.sepFilter2D(
                level.image, -1, _BLUR, _BLUR, dst=level.blurred, borderType=cv2.BORDER_REFLECT_101
            )
        angles = orientations(level.image, xs, ys)
        # The exact inverse of cv2.resize: integers are pixel centres, and levels have integer sizes.
        at = np.stack([xs, ys], axis=1)
        if self.config.subpixel:
            at = at + refine_corners(level.contrast, width, xs, ys)
        xy = ((at + 0.5) * level.pixel - 0.5).astype(np.float32)
        return (
            xy,
            np.full(len(chosen), octave, np.int32),
            angles,
            contrasts.astype(np.float32),
            descriptors(level.blurred, xs, ys, angles),
        )


def share_out(n_features: int, scale_factor: float, n_corners: list[int]) -> list[int]:
    """Distribute features over the levels as a geometric series, limited by each level's corners.

    Args:
        n_features: requested total.
        scale_factor: ratio of the series.
        n_corners: corners found on each level, the finest first.

    Returns:
        Features per level, at most ``n_corners``; the sum is ``n_features`` or all corners.
    """
    quotas = [0] * len(n_corners)
    open_levels = [k for k, n in enumerate(n_corners) if n]
    left = n_features
    while left and open_levels:
        weights = [scale_factor**-k for k in open_levels]
        total, spare = sum(weights), left
        for k, weight in zip(open_levels, weights, strict=True):
            # Each share is taken of the remainder, so that the rounded shares add up.
            share = min(round(spare * weight / total), left, n_corners[k] - quotas[k])
            quotas[k] += share
            left -= share
        still_open = [k for k in open_levels if quotas[k] < n_corners[k]]
        if spare == left:  # fewer features than levels: the finest open level gets the next one
            quotas[still_open[0]] += 1
            left -= 1
        open_levels = still_open
    return quotas
