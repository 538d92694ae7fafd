"""What stands about a path, seen from above: the world cut level at the camera's height."""

from dataclasses import dataclass

import cv2
import numpy as np

from sim.worlds.base import WorldModel

_SIZE = 480.0
_SMALLEST = 170.0
_MARGIN_SHARE, _MARGIN_M = 0.08, 2.0
# Pixels of the outline per unit of the map, for sharp screens.
_DETAIL = 2
# Cuts at the camera's height and below, where low things stand; storeys lie farther apart than the grid.
_CUTS_BELOW_M = (0.0, 1.0)
_STOREY_M = 2.0
_GREY = 128
_SUBPIXEL_BITS = 4


@dataclass(frozen=True)
class MapFrame:
    """The piece of the ground that a map shows, x to the right and y up.

    Attributes:
        left_m, top_m: its corner.
        px_per_m: scale of the map.
        width_px, height_px: of the map.
    """

    left_m: float
    top_m: float
    px_per_m: float
    width_px: float
    height_px: float

    def place(self, xy_m: np.ndarray) -> np.ndarray:
        """(..., 2) map coordinates, y downward, of (..., 2) points of the ground."""
        return (np.asarray(xy_m) - [self.left_m, self.top_m]) * [self.px_per_m, -self.px_per_m]


def frame_of(xy_m: np.ndarray) -> MapFrame:
    """A frame about (N, 2) points of the ground."""
    low, high = xy_m.min(axis=0), xy_m.max(axis=0)
    extent = high - low + 2 * max(_MARGIN_SHARE * float((high - low).max()), _MARGIN_M)
    px_per_m = _SIZE / float(extent.max())
    width, height = np.maximum(extent * px_per_m, _SMALLEST)
    left, _ = (low + high) / 2 - np.array([width, height]) / px_per_m / 2
    top = (low[1] + high[1]) / 2 + height / px_per_m / 2
    return MapFrame(float(left), float(top), px_per_m, float(width), float(height))


def draw_outline(world: WorldModel, heights_m: np.ndarray, frame: MapFrame) -> np.ndarray:
    """(h, w, 4) uint8 picture of the map: grey lines on nothing.

    Args:
        world: what is cut.
        heights_m: (N,) heights of the path; every storey it passes is cut.
        frame: of the map.
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
    """(n, 2, 2) ends of the lines in which the world's triangles cross a level."""
    corners = np.concatenate([s.vertices[s.triangles] for s in world.surfaces])
    above_m = corners[..., 2] - z_m
    corners = corners[(above_m.max(axis=1) > 0) & (above_m.min(axis=1) <= 0)]
    ends = np.roll(corners, -1, axis=1)
    from_m, to_m = corners[..., 2] - z_m, ends[..., 2] - z_m
    # Of a triangle that crosses, two sides do.
    crosses = (from_m > 0) != (to_m > 0)
    share = from_m[crosses] / (from_m - to_m)[crosses]
    met = corners[crosses] + share[:, None] * (ends - corners)[crosses]
    return met[:, :2].reshape(-1, 2, 2)


def _draw(lines: np.ndarray, ends: np.ndarray) -> None:
    """Draws (n, 2, 2) lines, those outside the picture left out."""
    low, high = ends.min(axis=1), ends.max(axis=1)
    seen = (high > 0).all(axis=1) & (low < lines.shape[::-1]).all(axis=1)
    fixed = np.rint(ends[seen] * 2**_SUBPIXEL_BITS).astype(np.int32)
    cv2.polylines(lines, list(fixed), False, 255, 1, cv2.LINE_AA, _SUBPIXEL_BITS)
