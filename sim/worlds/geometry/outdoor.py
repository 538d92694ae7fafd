"""Outdoor parts: daylight with cast shadows, the dome of the sky, level ground."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from dslab.scenarios.worlds import Outdoors
from dslab.sim.worlds.geometry.meshes import Mesh, Piece, grid_triangles

_CELL_M, _SHADOW_STEP_M = 0.4, 0.7
_TALLEST_M, _SHADOW_REACH_M = 18.5, (22.0, 90.0)  # what shadows are cast by, and how far they are followed
_SUNLIT, _SHADED = 1.6, 0.88
_OVERCAST, _OVERCAST_FROM_ABOVE = 0.9, 0.35
_OVERLAP_M = 4e-3
_SKY_SIDES, _SKY_RINGS = 48, 12
_SKY_FINISH = {"clear": "clouds", "overcast": "overcast"}
_RIDGE_SIDES, _RIDGE_SHARE, _RIDGE_SLOPE = 720, 0.6, (0.012, 0.075)


class Daylight:
    """Sun, sky light, and shadows cast by heights over the plan.

    Args:
        low, high: (2,) plan corners of the part of the world that has shadows, metres.
        rng: stream of the sun's position if the weather does not set it.
        weather: sky and sun.
    """

    def __init__(
        self, low: np.ndarray, high: np.ndarray, rng: np.random.Generator, weather: Outdoors | None = None
    ) -> None:
        weather = weather or Outdoors()
        azimuth, elevation = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(40, 58))
        if weather.sun_azimuth_deg is not None:
            azimuth = np.deg2rad(weather.sun_azimuth_deg)
        if weather.sun_elevation_deg is not None:
            elevation = np.deg2rad(weather.sun_elevation_deg)
        self.towards = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        self._overcast = weather.sky == "overcast"
        self._reach_m = float(np.clip(_TALLEST_M / np.tan(elevation), *_SHADOW_REACH_M))
        self._low = np.asarray(low, float)
        size = np.maximum(4, np.ceil((np.asarray(high) - self._low) / _CELL_M)).astype(int)
        self._height = np.zeros((size[1], size[0]), np.float32)

    def lay_ground(self, height_m: Callable[[np.ndarray], np.ndarray]) -> None:
        """Let hills cast shadows; ``height_m`` maps plan positions (..., 2) to (...)."""
        rows, columns = self._height.shape
        x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
        ground = height_m(self._low + _CELL_M * np.stack([x, y], axis=-1)).astype(np.float32)
        np.maximum(self._height, ground, out=self._height)

    def shade_polygon(self, corners: np.ndarray, height_m: float) -> None:
        """Add the shadow of a solid on a convex polygon (n, 2) of the plan."""
        cells = np.rint((corners - self._low) / _CELL_M * 8).astype(np.int32)
        low = np.maximum(cells.min(axis=0) // 8 - 1, 0)
        high = np.maximum(cells.max(axis=0) // 8 + 2, low)
        part = self._height[low[1] : high[1], low[0] : high[0]]
        mask = np.zeros_like(part)
        cv2.fillConvexPoly(mask, cells - 8 * low.astype(np.int32), height_m, shift=3)
        np.maximum(part, mask, out=part)

    def shade_round(self, spot: np.ndarray, radius_m: float, height_m: float) -> None:
        """Add the shadow of a round object about a plan position (2,)."""
        turn = 2 * np.pi * np.arange(8) / 8
        self.shade_polygon(spot + radius_m * np.column_stack([np.cos(turn), np.sin(turn)]), height_m)

    def gain(self, points: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """(...) float32 factors of light at points (..., 3) of a surface.

        Args:
            points: metres.
            normal: (3,) of all points, or (..., 3) of each.
        """
        normal = np.broadcast_to(normal, points.shape)
        if self._overcast:
            return (_OVERCAST + _OVERCAST_FROM_ABOVE * normal[..., 2]).astype(np.float32)
        cosine = normal @ self.towards
        sky = 0.86 + 0.14 * normal[..., 2]
        if (cosine <= 0).all():
            return (_SHADED * sky).astype(np.float32)
        lit = 1 - self._shadowed(points + 0.3 * normal)
        direct = np.where(cosine > 0, lit * np.minimum(1.0, 0.35 + cosine), 0.0)
        return (sky * (_SHADED + (_SUNLIT - _SHADED) * direct)).astype(np.float32)

    def _shadowed(self, points: np.ndarray) -> np.ndarray:
        """(...) share of the sunlight lost, by marching towards the sun over the heights."""
        level = self.towards / np.linalg.norm(self.towards[:2])
        column, row = (((points[..., k] - self._low[k]) / _CELL_M).astype(np.float32) for k in (0, 1))
        height = points[..., 2].astype(np.float32)
        blocked = np.zeros(points.shape[:-1], bool)
        for run in np.arange(0.0, self._reach_m, _SHADOW_STEP_M):
            x = (column + np.float32(run * level[0] / _CELL_M)).astype(np.int32)
            y = (row + np.float32(run * level[1] / _CELL_M)).astype(np.int32)
            blocked |= self._height.take(y * self._height.shape[1] + x, mode="clip") > height + run * level[2]
        return blocked.astype(np.float32)


@dataclass(frozen=True)
class Sky:
    """Dome and ground that enclose the world.

    Attributes:
        centre: (2,) plan position in the middle of the world.
        radius_m: far beyond everything else.
        ground: finish of the ground out to the sky.
        weather: its clouds.
    """

    centre: np.ndarray
    radius_m: float
    ground: str
    weather: Outdoors

    def pieces(self) -> list[Piece]:
        """The dome and the ground far outside, a little below z = 0."""
        ring, side = np.arange(_SKY_RINGS + 1), np.arange(_SKY_SIDES + 1)
        elevation = np.deg2rad(90.0 - 92.0 * ring / _SKY_RINGS)[:, None]
        turn = (2 * np.pi * side / _SKY_SIDES)[None]
        dome = np.stack(
            [
                np.cos(elevation) * np.cos(turn),
                -np.cos(elevation) * np.sin(turn),
                np.sin(elevation) + 0 * turn,
            ],
            axis=-1,
        )
        vertices = dome * self.radius_m + np.append(self.centre, 0.0)
        u = np.broadcast_to(side / _SKY_SIDES, dome.shape[:2])
        v = np.broadcast_to((ring / _SKY_RINGS)[:, None], dome.shape[:2])
        mesh = Mesh()
        mesh.add(
            vertices.reshape(-1, 3),
            grid_triangles(_SKY_RINGS + 1, _SKY_SIDES + 1),
            np.stack([u, v], -1).reshape(-1, 2) * (100.0, 25.0),
        )
        half = self.radius_m
        floor = Mesh()
        corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * half + self.centre
        floor.quad(np.column_stack([corners, np.full(4, -0.3)]), (0.0, 0.0), (60.0, 60.0))
        return [
            Piece.of(mesh, (100.0, 25.0), _SKY_FINISH[self.weather.sky], "sky"),
            Piece.of(floor, (60.0, 60.0), self.ground, "far ground"),
        ]

    def ridge(self, rng: np.random.Generator) -> Piece:
        """Far hills all around, a skyline that differs in every direction."""
        turn = 2 * np.pi * np.arange(_RIDGE_SIDES + 1) / _RIDGE_SIDES
        waves = np.arange(2, 60)
        phase = rng.uniform(0, 2 * np.pi, len(waves))[:, None]
        skyline = (np.sin(waves[:, None] * turn + phase) / waves[:, None] ** 1.1).sum(axis=0)
        skyline = (skyline - skyline.min()) / np.ptp(skyline)
        reach = _RIDGE_SHARE * self.radius_m
        top = reach * (_RIDGE_SLOPE[0] + (_RIDGE_SLOPE[1] - _RIDGE_SLOPE[0]) * skyline)
        plan = self.centre + reach * np.column_stack([np.cos(turn), -np.sin(turn)])
        rows = [np.column_stack([plan, top]), np.column_stack([plan, np.full(len(turn), -1.0)])]
        size = (120.0, 6.0)
        u = np.linspace(0, size[0], _RIDGE_SIDES + 1)
        sheet = [np.column_stack([u, size[1] * (1 - top / top.max())]), np.column_stack([u, 0 * u + size[1]])]
        mesh = Mesh()
        mesh.add(np.vstack(rows), grid_triangles(2, _RIDGE_SIDES + 1), np.vstack(sheet))
        return Piece.of(mesh, size, "far hills", "far hills")


def ground_piece(
    corner: np.ndarray,
    right: np.ndarray,
    size_m: tuple[float, float],
    finish: str,
    label: str,
    light: Daylight,
    z_m: float = 0.0,
) -> Piece:
    """A level rectangle at a height, seen from above, its sheet's upper left corner at ``corner`` (2,).

    ``right``, a unit vector (2,), leads along the upper edge; the sheet runs down to the right of it.
    """
    down = np.array([right[1], -right[0]])
    mesh = Mesh()
    # In single precision, pieces that only touch would leave cracks.
    low, wide, high = -_OVERLAP_M, size_m[0] + _OVERLAP_M, size_m[1] + _OVERLAP_M
    plan = [corner + u * right + v * down for u, v in ((low, low), (wide, low), (wide, high), (low, high))]
    mesh.quad(np.column_stack([plan, np.full(4, z_m)]), (0.0, 0.0), size_m)
    gain = ground_gain(corner, right, size_m, light, z_m)
    return Piece.of(mesh, size_m, finish, label, gain)


def ground_gain(
    corner: np.ndarray, right: np.ndarray, size_m: tuple[float, float], light: Daylight, z_m: float
) -> np.ndarray:
    """(rows, columns) light on a level rectangle as in ``ground_piece``."""
    down = np.array([right[1], -right[0]])
    columns, rows = (max(2, round(side / _CELL_M)) for side in size_m)
    u = (np.arange(columns) + 0.5) / columns * size_m[0]
    v = (np.arange(rows) + 0.5) / rows * size_m[1]
    plan = corner + u[None, :, None] * right + v[:, None, None] * down
    points = np.concatenate([plan, np.full((*plan.shape[:2], 1), z_m)], axis=-1)
    return light.gain(points, np.array([0.0, 0.0, 1.0]))
