"""Light and shade, baked into the textures so that they fade with the contrast."""

from dataclasses import dataclass

import numpy as np

from dslab.sim.worlds.geometry.panels import Box, Panel

_GRID_M = 0.08  # spacing of the light samples on a panel
_LAMP_SIZE_M = (1.2, 0.3, 0.06)
_LAMP_DROP_M = 0.15  # lamps are slightly below the ceiling, which would get no light otherwise
_NEAREST_LAMPS = 6  # nearest lamps that light a panel
_DARKEST, _BRIGHTEST = 0.55, 1.3
_EDGE_DEPTH, _EDGE_REACH_M = 0.35, 0.3


@dataclass(frozen=True)
class Light:
    """Lamps under the ceiling and the edges at which ambient light is lost.

    Attributes:
        lamps: (L, 2) float64 plan positions, metres.
        footprints: (S, 2, 2) float64 plan segments of walls and of furniture on the floor.
        height_m: of the ceiling.
    """

    lamps: np.ndarray
    footprints: np.ndarray
    height_m: float

    def gain(self, panel: Panel) -> np.ndarray:
        """(rows, columns) float32 factors about 1, one per cell of a coarse grid over the panel."""
        points = panel.cells(_GRID_M)
        gain = (0.62 + 0.45 * self._lamp_light(points, panel.normal)) * self._ambient(points, panel.normal)
        return np.clip(gain, _DARKEST, _BRIGHTEST).astype(np.float32)

    def _lamp_light(self, points: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Lambert's law summed over the nearest lamps, compressed, about 1 in mid-room."""
        middle = points.reshape(-1, 3)[:, :2].mean(axis=0)
        nearest = np.argsort(np.linalg.norm(self.lamps - middle, axis=1), kind="stable")[:_NEAREST_LAMPS]
        total = np.zeros(points.shape[:2])
        for lamp in self.lamps[nearest]:
            way = np.append(lamp, self.height_m - _LAMP_DROP_M) - points
            distance = np.linalg.norm(way, axis=-1)
            # Half of the light is scattered: surfaces turned away from a lamp are not black.
            cosine = 0.5 + 0.5 * (way @ normal) / distance
            total += np.maximum(cosine, 0.0) / (distance**2 + 0.5)
        scale = 0.9 / self.height_m**1.2
        return total / (total + scale)

    def _ambient(self, points: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Loss towards the edges where surfaces meet."""
        if abs(normal[2]) > 0.5:
            on_floor_or_ceiling = points[0, 0, 2] < 0.01 or points[0, 0, 2] > self.height_m - 0.01
            return (
                self._edge_loss(self._plan_distance(points, None))
                if on_floor_or_ceiling
                else np.ones(points.shape[:2])
            )
        edge = self._edge_loss(points[..., 2]) * self._edge_loss(self.height_m - points[..., 2])
        return edge * self._edge_loss(self._plan_distance(points[:1], normal))

    @staticmethod
    def _edge_loss(distance: np.ndarray) -> np.ndarray:
        return 1.0 - _EDGE_DEPTH * np.exp(-np.maximum(distance, 0.0) / _EDGE_REACH_M)

    def _plan_distance(self, points: np.ndarray, normal: np.ndarray | None) -> np.ndarray:
        """Distance in plan to the nearest footprint outside the panel's own plane."""
        plan = points[..., :2]
        start, way = self.footprints[:, 0], self.footprints[:, 1] - self.footprints[:, 0]
        near = np.ones(len(start), bool)
        if normal is not None:
            level = self.footprints @ normal[:2] - plan[0, 0] @ normal[:2]
            near = ~np.all(np.abs(level) < 1e-6, axis=1) & np.any(level > 1e-6, axis=1)
        middle, reach = plan.reshape(-1, 2).mean(axis=0), 4.0 + np.ptp(plan.reshape(-1, 2), axis=0).max()
        box_low, box_high = self.footprints.min(axis=1), self.footprints.max(axis=1)
        near &= np.all((box_low < middle + reach) & (box_high > middle - reach), axis=1)
        distance = np.full(plan.shape[:-1], np.inf)
        for a, d in zip(start[near], way[near], strict=True):
            t = np.clip(((plan - a) @ d) / (d @ d), 0.0, 1.0)
            distance = np.minimum(distance, np.linalg.norm(plan - a - t[..., None] * d, axis=-1))
        return distance


def lamp_boxes(lamps: np.ndarray, height_m: float, along: tuple[float, float]) -> list[Box]:
    """The visible lamps at (L, 2) plan positions under the ceiling, their longer side ``along`` x or y."""
    length, width, thick = _LAMP_SIZE_M
    half = np.array([length, width] if abs(along[0]) > 0.5 else [width, length]) / 2
    return [
        Box(
            np.append(spot - half, height_m - thick),
            np.append(spot + half, height_m),
            "lamp",
            f"lamp {spot[0]:.1f},{spot[1]:.1f}",
            ("top",),
        )
        for spot in lamps
    ]
