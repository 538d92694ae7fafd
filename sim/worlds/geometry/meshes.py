"""Triangle meshes made of simple shapes, and the pieces of worlds made of them.

Of every function that makes a piece, ``label`` is a readable name, unique in the world, ``rng`` the stream
of its shape, ``light`` the daylight that takes its shadow; all lengths are metres.
"""

from dataclasses import dataclass, field

import numpy as np

_QUAD = np.array([[0, 3, 2], [0, 2, 1]], np.int32)


@dataclass
class Mesh:
    """Vertices, triangles and texture coordinates that grow part by part.

    Texture coordinates are given in metres on the texture's sheet, v downward.
    """

    vertices: list[np.ndarray] = field(default_factory=list)
    triangles: list[np.ndarray] = field(default_factory=list)
    sheet_m: list[np.ndarray] = field(default_factory=list)
    _count: int = 0

    def add(self, vertices: np.ndarray, triangles: np.ndarray, sheet_m: np.ndarray) -> None:
        """Append a part: (V, 3) metres, (T, 3) counter-clockwise from outside, (V, 2) on the sheet."""
        self.vertices.append(np.asarray(vertices, float))
        self.triangles.append(np.asarray(triangles, np.int32) + self._count)
        self.sheet_m.append(np.asarray(sheet_m, float))
        self._count += len(vertices)

    def quad(self, corners: np.ndarray, low_m: tuple[float, float], size_m: tuple[float, float]) -> None:
        """Append a quadrangle (4, 3), clockwise from the upper left, with a part of the sheet."""
        u, v = np.array([0.0, 1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0, 1.0])
        sheet = np.column_stack([low_m[0] + u * size_m[0], low_m[1] + v * size_m[1]])
        self.add(corners, _QUAD, sheet)

    def tube(
        self,
        ends: np.ndarray,
        radii_m: tuple[float, float],
        sides: int,
        low_m: tuple[float, float],
        size_m: tuple[float, float],
    ) -> None:
        """Append an upright or leaning tube without caps between two points (2, 3)."""
        axis = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        across = np.cross(axis, [0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        turn = np.linspace(0, 2 * np.pi, sides + 1)[:, None]
        rim = np.cos(turn) * across + np.sin(turn) * np.cross(axis, across)
        vertices = np.vstack([ends[1] + radii_m[1] * rim, ends[0] + radii_m[0] * rim])
        u = np.linspace(0, 1, sides + 1)
        sheet = np.vstack([np.column_stack([low_m[0] + u * size_m[0], 0 * u + v]) for v in (0.0, 1.0)])
        sheet[:, 1] = low_m[1] + sheet[:, 1] * size_m[1]
        self.add(vertices, grid_triangles(2, sides + 1), sheet)


def block(
    mesh: Mesh,
    middle: np.ndarray,
    along: np.ndarray,
    size_m: tuple[float, float, float],
    low_m: tuple[float, float],
    per_m: float = 1.0,
) -> None:
    """Append a level box with all six faces.

    Args:
        mesh: extended by the box.
        middle: (3,) of its lower face, metres.
        along: (2,) unit vector of its length.
        size_m: length, width and height.
        low_m: upper left corner, on the sheet, of the part that each face shows.
        per_m: metres of the sheet per metre of the box.
    """
    length, wide, high = size_m
    x, y = np.append(along, 0.0) * length / 2, np.array([-along[1], along[0], 0.0]) * wide / 2
    up = rise(high)
    for out, across, side in ((-y, x, length), (x, y, wide), (y, -x, length), (-x, -y, wide)):
        left, right = middle + out - across, middle + out + across
        mesh.quad(np.array([left + up, right + up, right, left]), low_m, (per_m * side, per_m * high))
    lid = np.array([-x + y, x + y, x - y, -x - y])
    mesh.quad(middle + up + lid, low_m, (per_m * length, per_m * wide))
    mesh.quad(middle + lid[[3, 2, 1, 0]], low_m, (per_m * length, per_m * wide))


def rise(z_m: float) -> np.ndarray:
    """(3,) a step straight up, metres."""
    return np.array([0.0, 0.0, z_m])


def grid_triangles(rows: int, columns: int) -> np.ndarray:
    """(T, 3) triangles over a grid of vertices in row order, whose rows run downward as seen."""
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.stack([a, d, c, a, c, b], axis=-1)
    return faces.reshape(-1, 3)


def bumpy_ball(
    rows: int, sides: int, radii: tuple[float, float], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(rows, sides + 1, 3) unit vectors from pole to pole, and (rows, sides + 1, 1) uneven radii."""
    elevation = np.linspace(np.pi / 2, -np.pi / 2, rows)[:, None]
    turn = np.linspace(0, 2 * np.pi, sides + 1)[None]
    bumps = rng.uniform(*radii, (rows, sides + 1))
    bumps[:, -1], bumps[0], bumps[-1] = bumps[:, 0], bumps[0, 0], bumps[-1, 0]
    level = np.cos(elevation)
    ball = np.stack([level * np.cos(turn), level * np.sin(turn), np.sin(elevation) + 0 * turn], axis=-1)
    return ball, bumps[..., None]


@dataclass(frozen=True)
class Sheet:
    """A large drawing shared by several pieces, which then meet without a seam.

    Attributes:
        name: of the drawing; its pieces have the same finish.
        corner_m: (2,) upper left corner of the piece's part on it.
        size_m: width and height of the whole.
    """

    name: str
    corner_m: tuple[float, float]
    size_m: tuple[float, float]


@dataclass(frozen=True)
class Piece:
    """A mesh without its texture.

    Attributes:
        vertices: (V, 3) float64, metres, world frame.
        triangles: (T, 3) int32, counter-clockwise from the visible side.
        uv: (V, 2) texture coordinates in [0, 1], v downward.
        size_m: width and height of the texture's sheet, metres.
        finish: name of the finish that paints it.
        label: readable name, unique in the world.
        gain: (rows, columns) factors of light and shade, stretched over the sheet.
        detail: pixels per metre relative to the finish's own.
        part_of: the drawing that its texture is cut from; None for one of its own.
        twin: label of the piece that it repeats in another place; empty if it repeats none.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    uv: np.ndarray
    size_m: tuple[float, float]
    finish: str
    label: str
    gain: np.ndarray = field(default_factory=lambda: np.ones((2, 2), np.float32))
    detail: float = 1.0
    part_of: Sheet | None = None
    twin: str = ""

    @classmethod
    def of(
        cls,
        mesh: Mesh,
        size_m: tuple[float, float],
        finish: str,
        label: str,
        gain: np.ndarray | None = None,
        detail: float = 1.0,
        part_of: Sheet | None = None,
    ) -> "Piece":
        """Piece of a finished mesh, with sheet coordinates divided by the sheet's size."""
        lit = np.ones((2, 2), np.float32) if gain is None else gain
        uv = np.concatenate(mesh.sheet_m) / size_m
        return cls(
            np.concatenate(mesh.vertices),
            np.concatenate(mesh.triangles),
            np.clip(uv, 0.0, 1.0),
            size_m,
            finish,
            label,
            lit,
            detail,
            part_of,
        )
