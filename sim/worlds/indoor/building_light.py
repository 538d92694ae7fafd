"""Light of point lamps without shadows, for stairwells and for furniture in rooms."""

from dataclasses import dataclass

import numpy as np

from dslab.sim.worlds.geometry.meshes import Piece
from dslab.sim.worlds.geometry.panels import Panel
from dslab.sim.worlds.indoor.building_plan import Plan

_GRID_M = 0.2
_REACH_M2 = 1.5
_DARKEST, _BRIGHTEST = 0.55, 1.15
_NEAREST = 6  # nearest lamps that light a surface


@dataclass(frozen=True)
class Lamplight:
    """Point lights.

    Attributes:
        lamps: (L, 3) float64, metres.
    """

    lamps: np.ndarray

    def gain(self, panel: Panel) -> np.ndarray:
        """(rows, columns) float32 factors about 1, one per cell of a coarse grid over the panel."""
        return self._factor(panel.cells(_GRID_M), panel.normal)

    def piece_gain(self, piece: Piece) -> np.ndarray:
        """(rows, 1) float32 factors down a piece's sheet, at the places that its rows show."""
        rows = 16
        row = np.clip((piece.uv[:, 1] * rows).astype(int), 0, rows - 1)
        factor = self._factor(piece.vertices, np.array([0.0, 0.0, 1.0]))
        sums = np.bincount(row, factor, rows)
        count = np.bincount(row, minlength=rows)
        return np.where(count > 0, sums / np.maximum(count, 1), factor.mean())[:, None].astype(np.float32)

    def _factor(self, points: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Lambert's law with half of the light scattered, summed over the lamps and compressed."""
        middle = points.reshape(-1, 3).mean(axis=0)
        nearest = np.argsort(np.linalg.norm(self.lamps - middle, axis=1), kind="stable")[:_NEAREST]
        way = self.lamps[nearest] - points[..., None, :]
        distance = np.sqrt((way**2).sum(axis=-1))
        cosine = 0.5 + 0.5 * (way @ normal) / np.maximum(distance, 1e-6)
        total = (cosine / (distance**2 + _REACH_M2)).sum(axis=-1)
        factor = 0.55 + 0.62 * total / (total + 0.3)
        return np.clip(factor, _DARKEST, _BRIGHTEST).astype(np.float32)


def stair_light(plan: Plan) -> Lamplight:
    """Lamps over the stairs on every storey, and the daylight of every window."""
    lamps = []
    for well in plan.stairs:
        mouth = well.plan(well.foot_m / 2, well.width_m / 2)
        window = well.plan(well.depth_m - 0.4, well.width_m / 2)
        for level in range(well.floors):
            z = level * well.storey_m
            lamps.append([*mouth, z + plan.clear_m - 0.2])
            lamps.append([*window, z + well.storey_m / 2 + 1.3])
    return Lamplight(np.array(lamps))
