"""Recorded frames as seen by a camera that also turns on the spot.

Of a turn ``R``, from the turned camera's axes to the recording's, a pixel of the turned image with ray ``r``
shows what the recording has at ray ``R r``: without distortion that is the homography ``K R K^-1``, whatever
the scene. Nothing is known beyond the recording's borders, and nothing is made up there: all frames of the
sequence, turned or not, are cropped to one window, in which every turn sees only recorded pixels. The window
keeps the recording's pixels, focal length and lens; only its size and principal point are others.
"""

from dataclasses import replace
from functools import cached_property

import cv2
import numpy as np

from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.distortion import project, sample_depth, unproject

LEAST_SHARE = 0.5
"""Least share of the recording's width and height that the window may have."""
# Pixels beside a point that its interpolation takes.
_MARGIN_PX = 2
# Steps along the longer side in which the window is searched.
_STEPS = 80
_SAME_SURFACE = np.float32(1.05)
_STILL = 1e-9


class TurnedView:
    """The window of a recording that the turned camera sees in full.

    Args:
        recorded: intrinsics of the recording.
        turns: (M, 3, 3) rotations, turned camera to recording; the window is for all of them. None for none.

    Attributes:
        camera: intrinsics of the window; None if too little is left.
        left, top: the window's first pixel in the recording.
    """

    def __init__(self, recorded: Intrinsics, turns: np.ndarray | None = None) -> None:
        self._recorded = recorded
        self.left = self.top = 0
        self.camera: Intrinsics | None = recorded
        if turns is not None and len(turns):
            self._find_window(turns)

    def _find_window(self, turns: np.ndarray) -> None:
        recorded = self._recorded
        step = max(recorded.width_px, recorded.height_px) / _STEPS
        x, y = (
            np.unique(np.rint(np.linspace(0, size - 1, max(2, round(size / step)))).astype(int))
            for size in (recorded.width_px, recorded.height_px)
        )
        grid = np.stack(np.meshgrid(x, y), axis=-1).astype(float)
        rays = unproject(recorded, grid.reshape(-1, 2))
        seen = np.ones(len(rays), bool)
        for turn in turns:
            if not _is_still(turn):
                seen &= self._sees_recorded(rays, turn)
        top, bottom, left, right = _largest_rectangle(seen.reshape(len(y), len(x)), x, y)
        width, height = right - left + 1, bottom - top + 1
        cx, cy = recorded.cx - left, recorded.cy - top
        enough = width >= LEAST_SHARE * recorded.width_px and height >= LEAST_SHARE * recorded.height_px
        self.left, self.top, self.camera = left, top, None
        if enough and 0 <= cx <= width - 1 and 0 <= cy <= height - 1:
            self.camera = replace(recorded, width_px=width, height_px=height, cx=cx, cy=cy)

    def image(self, recorded: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """The window's image of a turn.

        Args:
            recorded: (H, W) uint8 or float32.
            turn: (3, 3) rotation, turned camera to recording.

        Returns:
            (h, w), a copy of the recorded pixels without a turn.
        """
        if _is_still(turn):
            return self.crop(recorded)
        at = self.source(turn)
        return cv2.remap(recorded, at, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)

    def depth(self, recorded_m: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """The window's depth (h, w) float32 along the turned axis; arguments as of ``image``."""
        if _is_still(turn):
            return self.crop(recorded_m)
        at = self.source(turn)
        # Of a ray of depth 1 in the turned camera, its depth in the recording.
        along = self._rays @ turn[2, :2] + turn[2, 2]
        depth_m = sample_depth(np.ascontiguousarray(recorded_m, np.float32), at, _SAME_SURFACE)
        return depth_m / along.reshape(depth_m.shape).astype(np.float32)

    def source(self, turn: np.ndarray) -> np.ndarray:
        """(h, w, 2) float32 pixels of the recording that the window's pixels show."""
        assert self.camera is not None
        rays = _turned(self._rays, turn)
        at = _project(self._recorded, rays).reshape(self.camera.height_px, self.camera.width_px, 2)
        most = (self._recorded.width_px - 1, self._recorded.height_px - 1)
        return np.clip(at, 0, np.array(most) - 1e-2).astype(np.float32)

    def crop(self, recorded: np.ndarray) -> np.ndarray:
        """The window's part (h, w, ...) of an array (H, W, ...) of pixels."""
        assert self.camera is not None
        bottom, right = self.top + self.camera.height_px, self.left + self.camera.width_px
        return np.ascontiguousarray(recorded[self.top : bottom, self.left : right])

    @cached_property
    def _rays(self) -> np.ndarray:
        """(h * w, 2) rays of the window's pixels at unit depth."""
        assert self.camera is not None
        x, y = np.meshgrid(np.arange(self.camera.width_px), np.arange(self.camera.height_px))
        return unproject(self.camera, np.stack([x, y], axis=-1).reshape(-1, 2).astype(float))

    def _sees_recorded(self, rays: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """(N,) bool: whether a turn shows at (N, 2) rays what can be interpolated from the recording."""
        turned = _turned(rays, turn)
        # Beyond the recording's own rays, a lens may fold the image over itself.
        seen = np.hypot(*turned.T) <= np.hypot(*rays.T).max()
        at = _project(self._recorded, np.where(seen[:, None], turned, 0))
        most = np.array([self._recorded.width_px - 1, self._recorded.height_px - 1]) - _MARGIN_PX
        return seen & np.all((at >= _MARGIN_PX) & (at <= most), axis=-1)


def _project(camera: Intrinsics, rays: np.ndarray) -> np.ndarray:
    """(N, 2) pixels of (N, 2) rays at unit depth."""
    if camera.is_pinhole:
        return rays * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    return project(camera, rays)


def _turned(rays: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """(N, 2) rays at unit depth after a rotation; NaN if they then point backwards."""
    points = rays @ turn[:, :2].T + turn[:, 2]
    return points[:, :2] / np.where(points[:, 2:] > 0, points[:, 2:], np.nan)


def _is_still(turn: np.ndarray) -> bool:
    return bool(np.abs(turn - np.eye(3)).max() < _STILL)


def _largest_rectangle(seen: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[int, int, int, int]:
    """First and last row and column of the largest rectangle of a grid in which all is seen.

    Args:
        seen: (R, C) bool.
        x: (C,) columns of the grid's points.
        y: (R,) their rows.
    """
    best, found = -1, (0, 0, 0, 0)
    columns = np.arange(len(x))
    for top in range(len(y)):
        open_columns = np.logical_and.accumulate(seen[top:], axis=0)
        # Of every rectangle that ends at a column, the column where it begins.
        begin = np.maximum.accumulate(np.where(open_columns, 0, columns + 1), axis=1)
        widths = np.where(open_columns, x - x[np.minimum(begin, columns)] + 1, 0)
        areas = widths * (y[top:] - y[top] + 1)[:, None]
        row, column = np.unravel_index(areas.argmax(), areas.shape)
        if areas[row, column] > best:
            best = areas[row, column]
            found = (y[top], y[top + row], x[begin[row, column]], x[column]) if best else found
    top, bottom, left, right = (int(place) for place in found)
    return top, bottom, left, right
