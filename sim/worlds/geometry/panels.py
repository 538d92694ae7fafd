"""Flat rectangular panels of worlds, and their conversion to textured surfaces."""

from dataclasses import dataclass

import numpy as np

from dslab.sim.worlds.base import Surface

# Panels overlap their neighbours by this much: single-precision edges would leave visible cracks.
_OVERLAP_M = 5e-4


@dataclass(frozen=True)
class Panel:
    """A flat rectangle before it has a texture.

    Attributes:
        corner: (3,) float64, metres, its top left corner seen from the visible side.
        right: (3,) unit vector along its upper edge.
        down: (3,) unit vector along its left edge.
        width_m, height_m: extents along ``right`` and ``down``.
        finish: name of the finish that paints it.
        label: readable name.
        twin: label of the panel that it repeats in another place; empty if it repeats none.
    """

    corner: np.ndarray
    right: np.ndarray
    down: np.ndarray
    width_m: float
    height_m: float
    finish: str
    label: str
    twin: str = ""

    @property
    def normal(self) -> np.ndarray:
        """(3,) unit vector towards the side it is seen from."""
        return np.cross(self.down, self.right)

    def points(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(..., 3) world points at the fractions ``u`` along ``right`` and ``v`` along ``down``."""
        along = np.asarray(u)[..., None] * self.width_m * self.right
        return self.corner + along + np.asarray(v)[..., None] * self.height_m * self.down

    def cells(self, step_m: float) -> np.ndarray:
        """(rows, columns, 3) world points, the middles of cells of about ``step_m``, at least 2 by 2."""
        rows, columns = (max(2, round(side / step_m)) for side in (self.height_m, self.width_m))
        return self.points(*np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows))

    def surface(self, texture: np.ndarray) -> Surface:
        """The panel with a texture whose rows run downward, slightly enlarged."""
        u, v = np.array([0.0, 1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0, 1.0])
        triangles = np.array([[0, 3, 2], [0, 2, 1]], np.int32)
        vertices = self.points(
            u + (2 * u - 1) * _OVERLAP_M / self.width_m, v + (2 * v - 1) * _OVERLAP_M / self.height_m
        )
        return Surface(vertices, triangles, np.column_stack([u, v]), texture, self.label)


_UP = np.array([0.0, 0.0, 1.0])


def wall(
    start: np.ndarray, end: np.ndarray, z_m: tuple[float, float], finish: str, label: str, longest_m: float
) -> list[Panel]:
    """Cut a vertical wall from ``start`` to ``end`` (2,), its left to its right, into panels.

    Args:
        start, end: plan positions, metres.
        z_m: lower and upper edge.
        finish, label: as in Panel.
        longest_m: no panel is longer than this.
    """
    start, end = np.asarray(start, float), np.asarray(end, float)
    length = float(np.linalg.norm(end - start))
    right = np.append((end - start) / length, 0.0)
    pieces = max(1, int(np.ceil(length / longest_m - 1e-9)))
    step = length / pieces
    origin = np.append(start, z_m[1])
    return [
        Panel(origin + k * step * right, right, -_UP, step, z_m[1] - z_m[0], finish, f"{label} {k}")
        for k in range(pieces)
    ]


def slab(
    low: np.ndarray,
    high: np.ndarray,
    z_m: float,
    up: bool,
    finish: str,
    label: str,
    longest_m: tuple[float, float],
) -> list[Panel]:
    """Cut a horizontal rectangle between two plan corners into panels.

    Args:
        low, high: plan corners, metres.
        z_m: its height.
        up: it is seen from above, else from below.
        finish, label: as in Panel.
        longest_m: no panel is longer than this in x and in y.
    """
    low, high = np.asarray(low, float), np.asarray(high, float)
    columns, rows = np.maximum(1, np.ceil((high - low) / longest_m - 1e-9)).astype(int)
    step = (high - low) / (columns, rows)
    right = np.array([1.0, 0.0, 0.0])
    down = np.array([0.0, -1.0, 0.0]) if up else np.array([0.0, 1.0, 0.0])
    panels = []
    for column in range(columns):
        for row in range(rows):
            x = low[0] + column * step[0]
            y = low[1] + (row + 1 if up else row) * step[1]
            corner = np.array([x, y, z_m])
            panels.append(Panel(corner, right, down, step[0], step[1], finish, f"{label} {column},{row}"))
    return panels


@dataclass(frozen=True)
class Box:
    """An axis-parallel piece of furniture.

    Attributes:
        low, high: (3,) float64 corners, metres.
        finish: of its faces.
        label: readable name.
        hidden: faces never seen and left out, of ``west east south north top bottom``.
        top: finish of the upper face; that of the others if empty.
    """

    low: np.ndarray
    high: np.ndarray
    finish: str
    label: str
    hidden: tuple[str, ...] = ()
    top: str = ""

    def outline(self) -> np.ndarray:
        """(4, 2, 2) plan segments of its sides, counter-clockwise from the south."""
        (x0, y0), (x1, y1) = self.low[:2], self.high[:2]
        corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)

    def panels(self) -> list[Panel]:
        """Its visible faces; on the floor it has no lower one."""
        z = (float(self.low[2]), float(self.high[2]))
        faces = []
        for side, (start, end) in zip(("south", "east", "north", "west"), self.outline(), strict=True):
            if side not in self.hidden:
                faces += wall(start, end, z, self.finish, f"{self.label} {side}", np.inf)
        plan = (self.low[:2], self.high[:2])
        if "top" not in self.hidden:
            finish = self.top or self.finish
            faces += slab(*plan, z[1], True, finish, f"{self.label} top", (np.inf, np.inf))
        if "bottom" not in self.hidden and z[0] > 0:
            faces += slab(*plan, z[0], False, self.finish, f"{self.label} bottom", (np.inf, np.inf))
        return faces


@dataclass(frozen=True)
class Fitting:
    """A kind of object along walls.

    Attributes:
        finish: as in Box.
        width_m: along the wall.
        height_m: from its foot up; it ends at the ceiling at the latest.
        reach: extent out from the wall, as a share of the allowed reach.
        foot_m: height of its lower end above the floor.
    """

    finish: str
    width_m: float
    height_m: float
    reach: float
    foot_m: float = 0.0

    def top_m(self, ceiling_m: float) -> float:
        """Height of its upper end under a ceiling."""
        return min(ceiling_m, self.foot_m + self.height_m)
