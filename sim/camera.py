"""The camera as the simulator and its files know it."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole intrinsics; integer pixel coordinates are pixel centres, as in OpenCV.

    Distortion is OpenCV's radtan (k1, k2, p1, p2, k3), dimensionless.
    """

    width_px: int
    height_px: int
    fx: float
    fy: float
    cx: float
    cy: float
    fps: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def K(self) -> np.ndarray:
        """(3, 3) float64 camera matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], float)
