"""Image pyramids of intensities and gradients, in the ideal camera.

A pixel that no pixel of the image as taken gives its light to is NaN, and so is whatever is computed from it.
Pixel u of a level is pixel 2u + .5 of the finer one: integer coordinates are pixel centres.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.direct._pyramid_kernels import halved, with_gradients

LEAST_SIDE_PX = 64
_LEAST_COARSE_SIDE_PX = 24
_MOST_LEVELS = 6
_OUTSIDE = np.float32(np.nan)


@dataclass(frozen=True)
class ImagePyramid:
    """An image at its own size, at half of it, and so on.

    Attributes:
        levels: (H, W, 3) float32 each, finest first: intensity 0 to 255, its change per pixel to the right
            and downward.
    """

    levels: tuple[np.ndarray, ...]

    def __len__(self) -> int:
        return len(self.levels)


class Rectifier:
    """Makes pyramids of the images of a camera, undistorted.

    Args:
        camera: of the images to come.

    Attributes:
        intrinsics: (L, 4) float64 fx, fy, cx, cy of every level.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        self._size = camera.height_px, camera.width_px
        sides = [min(self._size) >> level for level in range(_MOST_LEVELS)]
        levels = max(1, sum(side >= _LEAST_COARSE_SIDE_PX for side in sides))
        self.intrinsics = np.stack([_at_level(camera.intrinsics, level) for level in range(levels)])
        self._maps = _undistortion(camera)

    @property
    def is_too_small(self) -> bool:
        """True if an image of this size holds too little to align."""
        return min(self._size) < LEAST_SIDE_PX

    def pyramid(self, image: np.ndarray) -> ImagePyramid:
        """The pyramid of an image (H, W) uint8.

        Raises:
            ValueError: the image is not of the camera's size.
        """
        if image.shape != self._size:
            raise ValueError(f"an image of {image.shape} for a camera of {self._size} (height, width)")
        level = image.astype(np.float32)
        if self._maps is not None:
            level = cv2.remap(
                level, *self._maps, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, (float(_OUTSIDE),)
            )
        return self.pyramid_of(level)

    def pyramid_of(self, image: np.ndarray, finest: int = 0) -> ImagePyramid:
        """The pyramid of an image (H, W) float32 of the ideal camera at the size of level ``finest``."""
        levels = [with_gradients(image)]
        while len(levels) < len(self.intrinsics) - finest:
            image = halved(image)
            levels.append(with_gradients(image))
        return ImagePyramid(tuple(levels))


def _at_level(intrinsics: np.ndarray, level: int) -> np.ndarray:
    fx, fy, cx, cy = intrinsics
    share = 0.5**level
    return np.array([fx * share, fy * share, (cx + 0.5) * share - 0.5, (cy + 0.5) * share - 0.5])


def _undistortion(camera: PinholeCamera) -> tuple[np.ndarray, np.ndarray] | None:
    """Where each ideal pixel lies in the image as taken; None if at the same place."""
    if not any(camera.distortion) and not any(camera.residual):
        return None
    x, y = np.meshgrid(np.arange(camera.width_px, dtype=float), np.arange(camera.height_px, dtype=float))
    at = camera.distort_points(np.column_stack([x.ravel(), y.ravel()])).astype(np.float32)
    return at[:, 0].reshape(x.shape), at[:, 1].reshape(x.shape)
