"""Outlines of cars seen from the side, and the meshes made of them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dslab.sim.worlds.geometry.meshes import Mesh, grid_triangles

FLANK_M, STRIP_M, WAIST_M, WHEEL_M = 2.0, 1.8, 0.95, 0.32
"""Heights of the flank and of the strip on the sheet; height of the waist; radius of the wheels."""

_HALF_WIDTH_M, _ROOF_SHARE, _SILL_M = 0.88, 0.76, 0.2
_WHEEL_SIDES = 14


@dataclass(frozen=True)
class Shape:
    """One kind of car. Points are x forward from the rear bumper, z up, metres.

    Attributes:
        outline: from the rear bumper over the roof to the front bumper, x growing.
        glass: corners of the side windows.
        pillars: x of the door seams.
        axles: x of the wheels.
        panes: first and last outline point of the rear window and of the windscreen.
    """

    outline: tuple[tuple[float, float], ...]
    glass: tuple[tuple[float, float], ...]
    pillars: tuple[float, ...]
    axles: tuple[float, float]
    panes: tuple[tuple[int, int], tuple[int, int]]

    @property
    def length_m(self) -> float:
        """Over the bumpers."""
        return self.outline[-1][0]

    @property
    def sheet_m(self) -> tuple[float, float]:
        """Size of the texture's sheet."""
        return self.length_m, FLANK_M + STRIP_M

    @cached_property
    def mesh(self) -> Mesh:
        """Mesh of the car along +x, rear at x = 0, middle at y = 0."""
        mesh = Mesh()
        points = np.array(self.outline)
        half = _half_width(points[:, 1])
        for side in (1.0, -1.0):
            self._add_flank(mesh, points, half, side)
            for x in self.axles:
                self._add_wheel(mesh, x, side)
        over = np.stack([np.column_stack([points[:, 0], s * half, points[:, 1]]) for s in (1.0, -1.0)])
        u = np.array(self.shares()) * self.length_m
        sheet = np.stack([np.column_stack([u, np.full(len(u), v)]) for v in (FLANK_M, FLANK_M + STRIP_M)])
        mesh.add(over.reshape(-1, 3), grid_triangles(2, len(u)), sheet.reshape(-1, 2))
        return mesh

    def shares(self) -> list[float]:
        """Share of the outline's length at each of its points."""
        steps = np.linalg.norm(np.diff(np.array(self.outline), axis=0), axis=1)
        return (np.append(0.0, np.cumsum(steps)) / steps.sum()).tolist()

    def _add_flank(self, mesh: Mesh, points: np.ndarray, half: np.ndarray, side: float) -> None:
        """Sill to waist bulges out, waist to roof leans in."""
        x, top = points.T
        waist = np.minimum(top, WAIST_M)
        rows = [(top, half), (waist, _half_width(waist)), (np.full_like(x, _SILL_M), np.full_like(x, 0.82))]
        grid = np.concatenate([np.column_stack([x, side * y, z]) for z, y in rows])
        triangles = grid_triangles(3, len(x))
        sheet = np.column_stack([grid[:, 0], FLANK_M - grid[:, 2]])
        mesh.add(grid, triangles if side < 0 else triangles[:, ::-1], sheet)

    def _add_wheel(self, mesh: Mesh, x_m: float, side: float) -> None:
        """A disc a little proud of the flank, and its tread."""
        turn = np.linspace(0, 2 * np.pi, _WHEEL_SIDES + 1)
        rim = np.column_stack([x_m + WHEEL_M * np.cos(turn), 0 * turn, WHEEL_M * (1 + np.sin(turn))])
        outer, inner = (rim + side * np.array([0.0, y, 0.0]) for y in (0.89, 0.6))
        hub = np.array([[x_m, side * 0.89, WHEEL_M]])
        disc = np.vstack([hub, outer])
        k = np.arange(1, _WHEEL_SIDES + 1)
        fan = np.column_stack([0 * k, k, k + 1])
        mesh.add(disc, fan if side < 0 else fan[:, ::-1], np.column_stack([disc[:, 0], FLANK_M - disc[:, 2]]))
        tread = np.vstack([outer, inner])
        triangles = grid_triangles(2, _WHEEL_SIDES + 1)
        dark = np.tile([[0.5 * self.length_m, FLANK_M - 0.1]], (len(tread), 1))
        mesh.add(tread, triangles[:, ::-1] if side < 0 else triangles, dark)


def _half_width(z_m: np.ndarray) -> np.ndarray:
    """(...) half of the width at a height: upright to the waist, leaning in above."""
    above = np.clip((z_m - WAIST_M) / 0.55, 0, 1)
    return _HALF_WIDTH_M * (1 - (1 - _ROOF_SHARE) * above)


SALOON = Shape(
    ((0, 0.3), (0.03, 0.72), (0.12, 0.94), (0.8, 1.0), (1.35, 1.36), (2.0, 1.44), (2.65, 1.4), (3.3, 0.98),
     (4.05, 0.86), (4.36, 0.68), (4.42, 0.3)),
    ((1.0, 0.98), (1.45, 1.33), (2.05, 1.39), (2.6, 1.35), (3.1, 0.98)),
    (1.5, 2.3, 3.15),
    (0.85, 3.5),
    ((3, 4), (6, 7)),
)  # fmt: skip
HATCHBACK = Shape(
    ((0, 0.3), (0.02, 0.78), (0.1, 0.98), (0.38, 1.36), (1.1, 1.5), (1.95, 1.45), (2.72, 0.99), (3.45, 0.88),
     (3.78, 0.68), (3.84, 0.3)),
    ((0.42, 1.0), (0.55, 1.33), (1.15, 1.44), (1.9, 1.4), (2.5, 0.99)),
    (1.25, 2.5),
    (0.65, 3.05),
    ((2, 3), (5, 6)),
)  # fmt: skip
ESTATE = Shape(
    ((0, 0.3), (0.02, 0.8), (0.1, 1.0), (0.45, 1.4), (1.3, 1.5), (2.6, 1.46), (3.32, 1.0), (4.15, 0.88),
     (4.5, 0.68), (4.58, 0.3)),
    ((0.35, 1.0), (0.62, 1.36), (1.3, 1.44), (2.55, 1.41), (3.1, 1.0)),
    (1.45, 2.3, 3.15),
    (0.9, 3.65),
    ((2, 3), (5, 6)),
)  # fmt: skip
VAN = Shape(
    ((0, 0.35), (0.02, 1.0), (0.06, 1.7), (0.2, 1.95), (1.8, 1.98), (3.45, 1.92), (4.2, 1.22), (4.75, 1.0),
     (4.9, 0.7), (4.95, 0.35)),
    ((2.95, 1.15), (2.95, 1.7), (3.45, 1.7), (3.95, 1.15)),
    (1.5, 2.85, 3.9),
    (0.95, 4.0),
    ((1, 2), (5, 6)),
)  # fmt: skip
SHAPES = {"saloon": SALOON, "hatchback": HATCHBACK, "estate": ESTATE, "van": VAN}
"""By the name of their finish."""
