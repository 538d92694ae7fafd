"""Outline of the world from above: a horizontal cut at the height of the camera."""

from dataclasses import dataclass

import cv2
import numpy as np

from dslab.sim.worlds.base import WorldModel

_SIZE = 480.0
_SMALLEST = 170.0
_MARGIN_SHARE, _MARGIN_M = 0.08, 2.0
# Pixels of the outline per unit of the map, for high-resolution screens.
_DETAIL = 2
# Cuts at the camera's height and below, for low objects; storeys are farther apart than the grid.
_CUTS_BELOW_M = (0.0, 1.0)
_STOREY_M = 2.0
_GREY = 128
_SUBPIXEL_BITS = 4


@dataclass(frozen=True)
class MapFrame:
    """Area of the ground that a map shows, x to the right and y up.

    Attributes:
        left_m, top_m: upper left corner.
        px_per_m: scale of the map.
        width_px, height_px: size of the map.
    """

    left_m: float
    top_m: float
    px_per_m: float
    width_px: float
    height_px: float

    def place(self, xy_m: np.ndarray) -> np.ndarray:
        """Map (..., 2) points of the ground to (..., 2) map coordinates, y downward."""
        return (np.asarray(xy_m) - [self.left_m, self.top_m]) * [self.px_per_m, -self.px_per_m]


def frame_of(xy_m: np.ndarray) -> MapFrame:
    """Frame around (N, 2) points of the ground."""
    low, high = xy_m.min(axis=0), xy_m.max(axis=0)
    extent = high - low + 2 * max(_MARGIN_SHARE * float((high - low).max()), _MARGIN_M)
    px_per_m = _SIZE / float(extent.max())
    width, height = np.maximum(extent * px_per_m, _SMALLEST)
    left, _ = (low + high) / 2 - np.array([width, height]) / px_per_m / 2
    top = (low[1] + high[1]) / 2 + height / px_per_m / 2
    return MapFrame(float(left), float(top), px_per_m, float(width), float(height))


def draw_outline(world: WorldModel, heights_m: np.ndarray, frame: MapFrame) -> np.ndarray:
    """Draw the outline, (h, w, 4) uint8, as grey lines on a transparent ground.

    Args:
        world: the world to cut.
        heights_m: (N,) heights of the path; every storey that it passes is cut.
        frame: area of the map.
    """
    size = (round(frame.height_px * _DETAIL), round(frame.width_px * _DETAIL))
    lines = np.zeros(size, np.uint8)
    storeys = np.unique(np.floor((heights_m - heights_m.min()) / _STOREY_M))
    for storey in storeys:
        inside = np.floor((heights_m - heights_m.min()) / _STOREY_M) == storey
        for below_m in _CUTS_BELOW_M:
            cut = level_cut(world, float(np.median(heights_m[inside])) - below_m)
            _draw(lines, frame.place(cut) * _DETAIL)
    picture = np.full((*size, 4), _GREY, np.uint8)
    picture[..., 3] = lines
    return picture


def level_cut(world: WorldModel, z_m: float) -> np.ndarray:
    """Ends, (n, 2, 2), of the lines where the world's triangles cross a level."""
    corners = np.concatenate([s.vertices[s.triangles] for s in world.surfaces])
    above_m = corners[..., 2] - z_m
    corners = corners[(above_m.max(axis=1) > 0) & (above_m.min(axis=1) <= 0)]
    ends = np.roll(corners, -1, axis=1)
    from_m, to_m = corners[..., 2] - z_m, ends[..., 2] - z_m
    # A triangle that crosses the level has two sides that cross it.
    crosses = (from_m > 0) != (to_m > 0)
    share = from_m[crosses] / (from_m - to_m)[crosses]
    met = corners[crosses] + share[:, None] * (ends - corners)[crosses]
    return met[:, :2].reshape(-1, 2, 2)


def _draw(lines: np.ndarray, ends: np.ndarray) -> None:
    """Draw (n, 2, 2) lines, except those outside the picture."""
    low, high = ends.min(axis=1), ends.max(axis=1)
    seen = (high > 0).all(axis=1) & (low < lines.shape[::-1]).all(axis=1)
    fixed = np.rint(ends[seen] * 2**_SUBPIXEL_BITS).astype(np.int32)
    cv2.polylines(lines, list(fixed), False, 255, 1, cv2.LINE_AA, _SUBPIXEL_BITS)
