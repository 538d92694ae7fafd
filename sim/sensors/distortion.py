"""Lens distortion: each pixel is sampled from a wider image without distortion.

The wide image has the camera's focal length and pixel grid, so that a lens without distortion changes no
pixel. Where the lens compresses the view, several samples make a pixel, like its area on a sensor.
"""

from dataclasses import replace
from functools import cached_property

import cv2
import numpy as np
from numba import njit

from dslab.scenarios.errors import InputError
from dslab.scenarios.lenses import ray_fault, straightened
from dslab.sim.link import View
from dslab.sim.sensors.camera import Intrinsics

MOST_IDEAL_PX = 8192
_MARGIN_PX = 3  # border pixels for the interpolation
# OpenCV places a sample to 1/32 of a pixel; the mean of several is placed better.
_LEAST_SAMPLES, _MOST_SAMPLES = 2, 4
# Neighbouring depths with a larger ratio lie on different surfaces.
_SAME_SURFACE = np.float32(1.05)


class Lens:
    """The distortion of one camera, a link of the imaging chain after images of the ideal camera.

    Args:
        camera: the distorted camera.

    Attributes:
        camera: the same.
        ideal: pinhole camera, wide enough to hold everything that ``camera`` sees.

    Raises:
        InputError: the distortion folds the image over itself, or the lens sees too far to the side.
    """

    def __init__(self, camera: Intrinsics) -> None:
        self.camera = camera
        width, height = camera.width_px, camera.height_px
        corners = _grid(width + 1, height + 1, 1) - 0.5  # the corners of the pixels
        at = _ideal_pixels(camera, corners)
        low = np.floor(at.min(axis=(0, 1))).astype(int) - _MARGIN_PX
        size = np.ceil(at.max(axis=(0, 1))).astype(int) + _MARGIN_PX + 1 - low
        if size.max() > MOST_IDEAL_PX:
            problem = f"would take a pinhole image of {size[0]}x{size[1]} pixels"
            raise InputError("camera: distortion", problem, "give a narrower lens or a smaller image")
        self.ideal = Intrinsics(
            int(size[0]),
            int(size[1]),
            camera.fx,
            camera.fy,
            camera.cx - int(low[0]),
            camera.cy - int(low[1]),
            camera.fps,
        )
        self._samples = 1 if camera.is_pinhole else _samples_per_pixel(at)
        self._low = low

    def apply(self, image: np.ndarray, view: View) -> tuple[np.ndarray, View]:
        """See ``Link``: image and depth through the lens."""
        depth_m = None if view.depth_m is None else self.distort_depth(view.depth_m)
        return self.distort(image), replace(view, depth_m=depth_m)

    def distort(self, gray: np.ndarray) -> np.ndarray:
        """The camera's image (H, W) uint8 from the ideal camera's."""
        fine = cv2.remap(gray, self._sample_map, None, cv2.INTER_CUBIC)
        if self._samples == 1:
            return fine
        size = (self.camera.width_px, self.camera.height_px)
        return cv2.resize(fine, size, interpolation=cv2.INTER_AREA)

    def distort_depth(self, depth_m: np.ndarray) -> np.ndarray:
        """The camera's depth (H, W) float32, metres along the axis, from the ideal one.

        Exact on planes; at outlines the nearest pixel's depth, never a mixture.
        """
        return sample_depth(np.ascontiguousarray(depth_m, np.float32), self._centre_map, _SAME_SURFACE)

    def distort_labels(self, labels: np.ndarray) -> np.ndarray:
        """The camera's labels (H, W) from the ideal camera's: the nearest pixel's."""
        nearest = np.rint(self._centre_map).astype(np.intp)
        return labels[nearest[..., 1], nearest[..., 0]]

    # The maps are computed on first use: many callers need only the ideal camera.

    @cached_property
    def _sample_map(self) -> np.ndarray:
        return self._map(self._samples)

    @cached_property
    def _centre_map(self) -> np.ndarray:
        return self._map(1)

    def _map(self, samples: int) -> np.ndarray:
        """(H * samples, W * samples, 2) float32 positions of the samples in the wide image."""
        grid = _grid(self.camera.width_px, self.camera.height_px, samples)
        return np.ascontiguousarray(_ideal_pixels(self.camera, grid) - self._low, np.float32)


def project(camera: Intrinsics, rays: np.ndarray) -> np.ndarray:
    """(N, 2) float64 pixels of (N, 2) rays at unit depth, with the camera's distortion if any."""
    points = np.column_stack([rays, np.ones(len(rays))])[:, None]
    zero, coefficients = np.zeros(3), np.array(camera.distortion)
    if camera.model == "equidistant":
        return cv2.fisheye.projectPoints(points, zero, zero, camera.K, coefficients)[0][:, 0]
    return cv2.projectPoints(points, zero, zero, camera.K, coefficients)[0][:, 0]


def unproject(camera: Intrinsics, xy: np.ndarray) -> np.ndarray:
    """(N, 2) float64 rays at unit depth of (N, 2) pixels, with the camera's distortion if any.

    Raises:
        InputError: a pixel has no ray, several, or one too far to the side.
    """
    bent = (xy - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    rays = straightened(bent, camera.model, camera.distortion)
    if fault := ray_fault(rays, camera.distortion):
        raise InputError("camera: distortion", *fault)
    return rays


def _grid(width: int, height: int, samples: int) -> np.ndarray:
    """(H * samples, W * samples, 2) float64 pixel coordinates, ``samples`` squared evenly in each pixel."""
    x, y = ((np.arange(size * samples) + 0.5) / samples - 0.5 for size in (width, height))
    return np.stack(np.meshgrid(x, y), axis=-1)


def _ideal_pixels(camera: Intrinsics, xy: np.ndarray) -> np.ndarray:
    """Positions (..., 2) of pixels (..., 2) in an endless image without distortion."""
    rays = unproject(camera, xy.reshape(-1, 2)).reshape(xy.shape)
    return rays * (camera.fx, camera.fy) + (camera.cx, camera.cy)


def _samples_per_pixel(corners_at: np.ndarray) -> int:
    """Samples along each side of a pixel, about as dense as the wide image.

    Args:
        corners_at: (H + 1, W + 1, 2) positions of the pixels' corners in the wide image.
    """
    along_x, along_y = np.diff(corners_at, axis=1)[:-1], np.diff(corners_at, axis=0)[:, :-1]
    area = np.abs(along_x[..., 0] * along_y[..., 1] - along_x[..., 1] * along_y[..., 0])
    return int(np.clip(np.rint(np.sqrt(np.quantile(area, 0.95))), _LEAST_SAMPLES, _MOST_SAMPLES))


@njit(cache=True, nogil=True, error_model="numpy")
def sample_depth(depth_m, at, same_surface):
    """Depth at points between pixels: linear in its inverse, which is exact on a plane.

    Args:
        depth_m: (H, W) float32 metres, 0 for none.
        at: (h, w, 2) float32 x, y inside the image, a pixel from its border.
        same_surface: ratio of the largest to the smallest of the four neighbours up to which they are
            taken as one surface; beyond it, or if one has no depth, the nearest counts alone.

    Returns:
        (h, w) float32.
    """
    height, width = at.shape[:2]
    out = np.empty((height, width), np.float32)
    one, half = np.float32(1), np.float32(0.5)
    for row in range(height):
        for column in range(width):
            x, y = at[row, column, 0], at[row, column, 1]
            left, top = np.int32(x), np.int32(y)
            part_x, part_y = x - np.float32(left), y - np.float32(top)
            a, b = depth_m[top, left], depth_m[top, left + 1]
            c, d = depth_m[top + 1, left], depth_m[top + 1, left + 1]
            low, high = min(a, b, c, d), max(a, b, c, d)
            if low > 0 and high <= same_surface * low:
                upper = (one - part_x) / a + part_x / b
                lower = (one - part_x) / c + part_x / d
                out[row, column] = one / ((one - part_y) * upper + part_y * lower)
            else:
                out[row, column] = depth_m[np.int32(y + half), np.int32(x + half)]
    return out
