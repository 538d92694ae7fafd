"""Camera model of the estimator: pinhole, undistorted keypoints."""

import math
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from dslab.slam.core import _camera_kernels as kernels

# OpenCV's default of five iterations leaves pixels of error at the corners of a wide-angle lens.
_UNDISTORT_UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)
_MOST_UNDISTORT_ERROR_PX = 0.5
Residual = tuple[float, float, float, float]
NO_RESIDUAL: Residual = (0.0, 0.0, 0.0, 0.0)
_COEFFICIENTS = {"radtan": 5, "rational": 8, "equidistant": 4}


@dataclass(frozen=True)
class PinholeCamera:
    """Intrinsics in pixels; integer pixel coordinates are pixel centres, as in OpenCV.

    ``residual`` is what the distortion leaves: coefficients (k1, k2, p1, p2), radial and decentring, by which
    an ideal point (x, y) at radius r, in units of the focal length, lies in the undistorted image at
    x (1 + k1 r² + k2 r⁴) + 2 p1 x y + p2 (r² + 2 x²), and y likewise (Brown's model, as in OpenCV). It is not
    calibrated but estimated, see :mod:`slam.optimization.lens`. So is ``readout_s``, the time in which a
    rolling shutter reads the image from its first row to its last; 0 for a global one.

    ``distortion`` follows OpenCV: (k1, k2, p1, p2, k3) for the model ``radtan``, with (k4, k5, k6) for
    ``rational``, (k1, k2, k3, k4) for ``equidistant`` (OpenCV's fisheye).

    Raises:
        ValueError: a field is out of range (the message names it), or the distortion folds the image over
            itself and cannot be inverted.
    """

    width_px: int
    height_px: int
    fx: float
    fy: float
    cx: float
    cy: float
    fps: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    model: Literal["radtan", "rational", "equidistant"] = "radtan"
    residual: Residual = NO_RESIDUAL
    readout_s: float = 0.0

    def __post_init__(self) -> None:
        """Check every field."""
        for name in ("width_px", "height_px"):
            value = getattr(self, name)
            if not isinstance(value, (int, np.integer)) or value < 1:
                raise ValueError(f"camera {name} must be a whole number of at least 1, is {value}")
        for name in ("fx", "fy", "fps"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"camera {name} must be finite and greater than 0, is {value}")
        for name, size in (("cx", self.width_px), ("cy", self.height_px)):
            value = getattr(self, name)
            if not 0 <= value <= size:
                raise ValueError(f"camera {name} must lie in the image, in [0, {size}], is {value}")
        if self.model not in _COEFFICIENTS:
            raise ValueError(f"camera model must be {' or '.join(_COEFFICIENTS)}, is {self.model!r}")
        count = _COEFFICIENTS[self.model]
        if len(self.distortion) != count or not all(math.isfinite(k) for k in self.distortion):
            raise ValueError(f"camera distortion must be {count} finite numbers, is {self.distortion}")
        if not self._is_pinhole:
            self._check_invertible()

    @property
    def is_large(self) -> bool:
        """True for images larger than about 640x480, such as KITTI's."""
        return self.width_px * self.height_px > 1.2 * 640 * 480

    @property
    def K(self) -> np.ndarray:
        """(3, 3) float64 camera matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], float)

    @property
    def intrinsics(self) -> np.ndarray:
        """(4,) float64 fx, fy, cx, cy."""
        return np.array([self.fx, self.fy, self.cx, self.cy], float)

    def undistort_points(self, xy: np.ndarray) -> np.ndarray:
        """Undistort image points.

        Args:
            xy: (N, 2) float32 pixels of the image as taken.

        Returns:
            (N, 2) float32 pixels of the ideal camera ``K``; ``xy`` itself if there is no distortion.
        """
        if not len(xy):
            return xy
        points = xy if self._is_pinhole else self._undistorted(xy)
        if any(self.residual):
            points = undistort_residual(points, self.residual, self.intrinsics).astype(np.float32)
        return points

    def distort_points(self, xy: np.ndarray) -> np.ndarray:
        """Invert :meth:`undistort_points`: where the image as taken shows ideal pixels.

        Args:
            xy: (N, 2) pixels of the ideal camera ``K``.

        Returns:
            (N, 2) float64 pixels.
        """
        points = distort_residual(xy, self.residual, self.intrinsics) if any(self.residual) else xy
        if self._is_pinhole:
            return np.asarray(points, float)
        rays = np.column_stack([(points - self.intrinsics[2:]) / self.intrinsics[:2], np.ones(len(points))])
        return self._projected(rays)

    def ideal_points(self, xy_image: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Undistort image points, and take each to where it is at the time of the middle row.

        Args:
            xy_image: (N, 2) float32 pixels of the image as taken.
            twist: (6,) how the scene moves past the camera, in its frame: velocity over the median depth of
                what it sees, 1/s, and angular velocity, rad/s.

        Returns:
            (N, 2) float64 pixels of the ideal camera ``K``.
        """
        xy = self.undistort_points(xy_image).astype(np.float64)
        if self.readout_s and len(xy):
            xy -= self.readout_s * self.row_shifts(xy_image, xy, twist)
        return xy

    def row_shifts(self, xy_image: np.ndarray, xy: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Shift of points per second of read-out time, as their rows are read before or after the middle one.

        All points are taken to be at the median depth: before a wall, where a turn and a movement look alike,
        both together are right, however the two are mistaken for each other.

        Args:
            xy_image: (N, 2) pixels of the image as taken.
            xy: (N, 2) the same, undistorted.
            twist: as for :meth:`ideal_points`.

        Returns:
            (N, 2) px/s.
        """
        rows = np.ascontiguousarray(xy_image[:, 1], np.float64)
        at = np.ascontiguousarray(xy, np.float64)
        return kernels.row_shifts(rows, at, np.asarray(twist, float), self.intrinsics, float(self.height_px))

    def _undistorted(self, xy: np.ndarray) -> np.ndarray:
        K = self.K
        undistort = cv2.fisheye.undistortPoints if self.model == "equidistant" else cv2.undistortPoints
        points = undistort(
            np.ascontiguousarray(xy, np.float32)[:, None],
            K,
            np.array(self.distortion),
            P=K,
            criteria=_UNDISTORT_UNTIL,
        )
        return points[:, 0]

    def undistorted_bounds(self) -> tuple[float, float, float, float]:
        """Bounding box of the undistorted image, including the edges of its pixels.

        Returns:
            x_min, y_min, x_max, y_max in pixels.
        """
        xy = self.undistort_points(self._outline())
        (x_min, y_min), (x_max, y_max) = xy.min(axis=0), xy.max(axis=0)
        return float(x_min), float(y_min), float(x_max), float(y_max)

    def _projected(self, rays: np.ndarray) -> np.ndarray:
        project = cv2.fisheye.projectPoints if self.model == "equidistant" else cv2.projectPoints
        pixels, _ = project(rays[:, None], np.zeros(3), np.zeros(3), self.K, np.array(self.distortion))
        return pixels[:, 0]

    @property
    def _is_pinhole(self) -> bool:
        return self.model != "equidistant" and not any(self.distortion)

    def _outline(self) -> np.ndarray:
        x = np.arange(self.width_px + 1, dtype=np.float32) - 0.5
        y = np.arange(self.height_px + 1, dtype=np.float32) - 0.5
        return np.concatenate(
            [np.stack([x, np.full_like(x, end)], axis=1) for end in y[[0, -1]]]
            + [np.stack([np.full_like(y, end), y], axis=1) for end in x[[0, -1]]]
        )

    def _check_invertible(self) -> None:
        outline = self._outline()
        ideal = self._undistorted(outline)
        rays = np.column_stack([(ideal - [self.cx, self.cy]) / [self.fx, self.fy], np.ones(len(ideal))])
        error = np.abs(self._projected(rays) - outline).max() if np.isfinite(rays).all() else np.inf
        if error < _MOST_UNDISTORT_ERROR_PX:
            return
        raise ValueError(f"camera distortion cannot be taken out over the whole image: {self.distortion}")


def distort_residual(xy: np.ndarray, residual: Residual, intrinsics: np.ndarray) -> np.ndarray:
    """Move ideal pixels to where a camera with a residual distortion sees them.

    Args:
        xy: (N, 2) px.
        residual: see :class:`PinholeCamera`.
        intrinsics: (4,) fx, fy, cx, cy.

    Returns:
        (N, 2) float64 px.
    """
    rays = (xy - intrinsics[2:]) / intrinsics[:2]
    stretch, shift = _residual_at(rays, residual)
    return (rays * stretch + shift) * intrinsics[:2] + intrinsics[2:]


def undistort_residual(xy: np.ndarray, residual: Residual, intrinsics: np.ndarray) -> np.ndarray:
    """Invert :func:`distort_residual` by fixed-point iteration, to a thousandth of a pixel.

    It converges where the distortion is small, as a residual one is.
    """
    return kernels.undistort_residual(np.ascontiguousarray(xy, np.float64), np.array(residual), intrinsics)


def _residual_at(rays: np.ndarray, residual: Residual) -> tuple[np.ndarray, np.ndarray]:
    """(N, 1) factor and (N, 2) shift by which a residual distortion moves image points (N, 2)."""
    k1, k2, p1, p2 = residual
    r2 = (rays**2).sum(axis=1, keepdims=True)
    shift = 2 * rays[:, :1] * rays[:, 1:] * [p1, p2] + (r2 + 2 * rays**2) * [p2, p1]
    return 1.0 + r2 * (k1 + r2 * k2), shift
