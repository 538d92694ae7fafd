"""The camera as the simulator and its files know it."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

LensModel = Literal["radtan", "rational", "equidistant"]

DISTORTION_KEYS: dict[str, tuple[str, ...]] = {
    "radtan": ("k1", "k2", "p1", "p2", "k3"),
    "rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}
"""Names of the coefficients of each lens model, in OpenCV's order."""
LEAST_SIDE_PX, MOST_SIDE_PX = 37, 16384
"""Sides of an image; a smaller one holds no whole neighbourhood of a feature of the SLAM."""
MOST_PIXELS = 2**25
"""Pixels of an image: 8K video has as many."""


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsics in pixels; integer pixel coordinates are pixel centres, as in OpenCV.

    Distortion is OpenCV's, dimensionless: of the model ``radtan`` (k1, k2, p1, p2, k3), of ``rational`` three
    more (k4, k5, k6), of ``equidistant`` (OpenCV's fisheye) (k1, k2, k3, k4).
    """

    width_px: int
    height_px: int
    fx: float
    fy: float
    cx: float
    cy: float
    fps: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    model: LensModel = "radtan"

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""
        return self.width_px, self.height_px

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal lengths."""
        return self.fx, self.fy

    @property
    def centre_px(self) -> tuple[float, float]:
        """Principal point."""
        return self.cx, self.cy

    @property
    def K(self) -> np.ndarray:
        """(3, 3) float64 camera matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], float)

    def scaled(self, width_px: int, height_px: int | None = None) -> "Intrinsics":
        """The same view in images of another size; without a height, with pixels of the same shape."""
        along_x = width_px / self.width_px
        along_y = along_x if height_px is None else height_px / self.height_px
        return replace(
            self,
            width_px=width_px,
            height_px=height_px or max(2, round(self.height_px * along_x)),
            fx=self.fx * along_x,
            fy=self.fy * along_y,
            cx=(self.cx + 0.5) * along_x - 0.5,
            cy=(self.cy + 0.5) * along_y - 0.5,
        )

    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        """(W,) and (H, 1) rays of the pixels at unit depth, x and y, as if there were no distortion."""
        x = (np.arange(self.width_px) - self.cx) / self.fx
        return x, ((np.arange(self.height_px) - self.cy) / self.fy)[:, None]

    def ray_lengths(self) -> np.ndarray:
        """(H, W) float32 distance from the camera per depth along the optical axis, likewise."""
        x, y = self.rays()
        return np.sqrt(1 + x**2 + y**2).astype(np.float32)

    @property
    def is_pinhole(self) -> bool:
        """Return True if the camera has no distortion."""
        return self.model != "equidistant" and not any(self.distortion)
