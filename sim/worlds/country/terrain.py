"""Hilly ground about a level route, cut into tiles that meet without a seam."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates

from dslab.sim.worlds.geometry.meshes import Mesh, Piece, Sheet, grid_triangles
from dslab.sim.worlds.geometry.outdoor import Daylight

_CELL_M = 0.5  # of the height map
_VERTEX_M, _LIGHT_M = 1.0, 0.5
_LEVEL_M, _RISE_M = 2.0, 14.0  # the ground is level this near the route, and hilly this much farther
_HILLS_M, _BUMPS_M = (24.0, 60.0), (3.0, 7.0)  # wavelengths
_BUMP_HEIGHT_M = 0.18
_MARGIN_M = 0.6  # of a tile's sheet, so that coarse mipmaps do not mix opposite edges


class Relief:
    """Heights over the plan, 0 about the route, never below.

    Args:
        line: (M, 2) the route, metres.
        half: (2,) the ground reaches from -half to half.
        hills_m: height of the highest hill.
        rng: stream of its shape.
        turned: half a turn about the origin changes nothing.
    """

    def __init__(
        self,
        line: np.ndarray,
        half: np.ndarray,
        hills_m: float,
        rng: np.random.Generator,
        turned: bool = False,
    ) -> None:
        self._low = -np.asarray(half, float)
        columns, rows = (np.ceil(2 * half / _CELL_M) + 2).astype(int)
        x, y = np.meshgrid(np.arange(columns), np.arange(rows))
        plan = self._low + _CELL_M * np.stack([x, y], axis=-1)
        self._line = line
        away = _distance(plan.shape[:2], (line - self._low) / _CELL_M) * _CELL_M
        waves = _turned_waves if turned else _waves
        hills, bumps = waves(plan, _HILLS_M, rng), waves(plan, _BUMPS_M, rng)
        rise = np.clip((away - _LEVEL_M) / _RISE_M, 0, 1)
        near = np.clip((away - 0.5 * _LEVEL_M) / _LEVEL_M, 0, 1)
        self._heights = (hills_m * rise**2 * (3 - 2 * rise) * hills + _BUMP_HEIGHT_M * near * bumps).astype(
            np.float32
        )

    def height(self, points: np.ndarray) -> np.ndarray:
        """(...) float64 height at plan positions (..., 2), metres."""
        column, row = np.moveaxis((np.asarray(points) - self._low) / _CELL_M, -1, 0)
        return map_coordinates(self._heights, [row, column], float, order=1, mode="nearest")

    def normal(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) float64 upward unit normals at plan positions (..., 2)."""
        step = np.array([_CELL_M, 0.0])
        slopes = [
            (self.height(points + d) - self.height(points - d)) / (2 * _CELL_M) for d in (step, step[::-1])
        ]
        normals = np.stack([-slopes[0], -slopes[1], np.ones_like(slopes[0])], axis=-1)
        return normals / np.linalg.norm(normals, axis=-1, keepdims=True)

    def away(self, spot: np.ndarray) -> float:
        """Distance of a plan position (2,) from the points of the route, metres."""
        return float(np.linalg.norm(self._line - spot, axis=1).min())

    def stand(self, spot: np.ndarray) -> np.ndarray:
        """(3,) point of the ground at a plan position (2,)."""
        return np.append(spot, float(self.height(np.asarray(spot)[None])[0]))


@dataclass(frozen=True)
class Tiling:
    """Tiling of the ground.

    Attributes:
        half: (2,) the ground reaches from -half to half, metres.
        tiles: per side.
        finish: of all of it, drawn as one.
        close_m: ground this near the route has more detail.
        detail: pixels per metre there, relative to the rest.
    """

    half: np.ndarray
    tiles: int
    finish: str
    close_m: float
    detail: float

    def pieces(self, relief: Relief, light: Daylight) -> list[Piece]:
        """The tiles, row by row."""
        size = 2 * self.half / self.tiles
        corners = [(i, j) for j in range(self.tiles) for i in range(self.tiles)]
        return [self._tile(-self.half + size * corner, size, relief, light, corner) for corner in corners]

    def _tile(
        self,
        low: np.ndarray,
        size: np.ndarray,
        relief: Relief,
        light: Daylight,
        name: tuple[int, int],
    ) -> Piece:
        counts = np.maximum(2, np.rint(size / _VERTEX_M).astype(int)) + 1
        # Rows run downward as seen from above with x to the right, hence from the highest y to the lowest.
        x, y = np.meshgrid(
            low[0] + np.linspace(0, size[0], counts[0]), low[1] + np.linspace(size[1], 0, counts[1])
        )
        plan = np.stack([x, y], axis=-1).reshape(-1, 2)
        mesh = Mesh()
        corner = np.array([low[0] - _MARGIN_M, low[1] + size[1] + _MARGIN_M])
        sheet = (plan - corner) * [1.0, -1.0]
        mesh.add(np.column_stack([plan, relief.height(plan)]), grid_triangles(counts[1], counts[0]), sheet)
        sheet_m = (float(size[0] + 2 * _MARGIN_M), float(size[1] + 2 * _MARGIN_M))
        place = Sheet(
            "ground",
            tuple((corner - self.half * [-1, 1] + [_MARGIN_M, -_MARGIN_M]) * [1.0, -1.0]),
            tuple(2 * self.half + 2 * _MARGIN_M),
        )
        gain = _gain(corner, sheet_m, relief, light)
        label = f"ground {name[0]},{name[1]}"
        detail = self.detail if relief.away(low + size / 2) < self.close_m else 1.0
        return Piece.of(mesh, sheet_m, self.finish, label, gain, detail, place)


def _gain(corner: np.ndarray, size_m: tuple[float, float], relief: Relief, light: Daylight) -> np.ndarray:
    columns, rows = (max(2, round(side / _LIGHT_M)) for side in size_m)
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    plan = corner + np.stack([u * size_m[0], -v * size_m[1]], axis=-1)
    points = np.concatenate([plan, relief.height(plan)[..., None]], axis=-1)
    return light.gain(points, relief.normal(plan))


def _distance(shape: tuple[int, int], line: np.ndarray) -> np.ndarray:
    """(rows, columns) distance from a polyline given in cells."""
    free = np.full(shape, 255, np.uint8)
    cv2.polylines(free, [np.rint(line).astype(np.int32)], False, 0, 1)
    # Not cv2.distanceTransform, whose last bits depend on the number of threads.
    return np.asarray(distance_transform_edt(free))


def _turned_waves(plan: np.ndarray, lengths_m: tuple[float, float], rng: np.random.Generator) -> np.ndarray:
    """Waves as below that are the same at opposite points."""
    both = _waves(np.stack([plan, -plan]), lengths_m, rng)
    return both.mean(axis=0)


def _waves(plan: np.ndarray, lengths_m: tuple[float, float], rng: np.random.Generator) -> np.ndarray:
    """(...) sum of waves in all directions, between 0 and 1."""
    total = np.zeros(plan.shape[:-1])
    for turn in np.linspace(0, np.pi, 7, endpoint=False):
        way = 2 * np.pi / rng.uniform(*lengths_m) * np.array([np.cos(turn), np.sin(turn)])
        total += np.sin(plan @ way + rng.uniform(0, 2 * np.pi))
    return (total - total.min()) / np.ptp(total)
