"""What is under the sky: daylight with cast shadows, the dome of the sky, level ground."""

from dataclasses import dataclass

import cv2
import numpy as np

from sim.world.meshes import Mesh, Piece, grid_triangles

_CELL_M, _SHADOW_REACH_M, _SHADOW_STEP_M = 0.4, 22.0, 0.7
_SUNLIT, _SHADED = 1.6, 0.88
_OVERLAP_M = 4e-3
_SKY_SIDES, _SKY_RINGS = 48, 12


class Daylight:
    """A low or high sun, sky light, and what casts shadows, known by its height over the plan.

    Args:
        low, high: (2,) plan corners of the part of the world that has shadows, metres.
        rng: stream of the sun's place.
    """

    def __init__(self, low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> None:
        azimuth, elevation = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(40, 58))
        self.towards = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        self._low = np.asarray(low, float)
        size = np.maximum(4, np.ceil((np.asarray(high) - self._low) / _CELL_M)).astype(int)
        self._height = np.zeros((size[1], size[0]), np.float32)

    def shade_polygon(self, corners: np.ndarray, height_m: float) -> None:
        """Something solid stands on a convex polygon (n, 2) of the plan."""
        cells = np.rint((corners - self._low) / _CELL_M * 8).astype(np.int32)
        low = np.maximum(cells.min(axis=0) // 8 - 1, 0)
        high = np.maximum(cells.max(axis=0) // 8 + 2, low)
        part = self._height[low[1] : high[1], low[0] : high[0]]
        mask = np.zeros_like(part)
        cv2.fillConvexPoly(mask, cells - 8 * low.astype(np.int32), height_m, shift=3)
        np.maximum(part, mask, out=part)

    def gain(self, points: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """(...) float32 factors of light at points (..., 3) of a surface with one normal."""
        cosine = float(normal @ self.towards)
        sky = 0.86 + 0.14 * float(normal[2])
        if cosine <= 0:
            return np.full(points.shape[:-1], _SHADED * sky, np.float32)
        lit = 1 - self._shadowed(points + 0.3 * normal)
        return (sky * (_SHADED + (_SUNLIT - _SHADED) * lit * min(1.0, 0.35 + cosine))).astype(np.float32)

    def _shadowed(self, points: np.ndarray) -> np.ndarray:
        """(...) share of the sunlight lost, by marching towards the sun over the heights."""
        level = self.towards / np.linalg.norm(self.towards[:2])
        column, row = (((points[..., k] - self._low[k]) / _CELL_M).astype(np.float32) for k in (0, 1))
        height = points[..., 2].astype(np.float32)
        blocked = np.zeros(points.shape[:-1], bool)
        for run in np.arange(0.0, _SHADOW_REACH_M, _SHADOW_STEP_M):
            x = (column + np.float32(run * level[0] / _CELL_M)).astype(np.int32)
            y = (row + np.float32(run * level[1] / _CELL_M)).astype(np.int32)
            blocked |= self._height.take(y * self._height.shape[1] + x, mode="clip") > height + run * level[2]
        return blocked.astype(np.float32)


@dataclass(frozen=True)
class Sky:
    """What closes the world around and above.

    Attributes:
        centre: (2,) plan position in the middle of the world.
        radius_m: far beyond everything else.
        ground: finish of the ground out to the sky.
    """

    centre: np.ndarray
    radius_m: float
    ground: str

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
            Piece.of(mesh, (100.0, 25.0), "clouds", "sky"),
            Piece.of(floor, (60.0, 60.0), self.ground, "far ground"),
        ]


def ground_piece(
    corner: np.ndarray,
    right: np.ndarray,
    size_m: tuple[float, float],
    finish: str,
    label: str,
    light: Daylight,
    z_m: float = 0.0,
) -> Piece:
    """A level rectangle seen from above, its sheet's upper left corner at ``corner`` (2,).

    Args:
        corner: plan position, metres.
        right: (2,) unit vector along the sheet's upper edge; the sheet runs down to the right of it.
        size_m: width along ``right`` and height.
        finish, label: as in Piece.
        light: daylight.
        z_m: its height.
    """
    down = np.array([right[1], -right[0]])
    mesh = Mesh()
    # Rounded to single precision, pieces that only touch would leave cracks between them.
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
