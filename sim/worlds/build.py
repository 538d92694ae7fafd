"""From panels to a built world: one unique, lit texture per panel."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from scenarios.seeds import rng_for
from sim.worlds.base import WorldModel
from sim.worlds.geometry.panels import Panel
from sim.worlds.materials.finishes import FINISHES, paint
from sim.worlds.materials.textures import multiply

# The level every texture fades to. One for all: where all contrast is gone, surfaces meet without an edge.
MEAN_LEVEL = 118.0
# Texture detail in pixels per metre: a wall is seen from 1 m, floor and ceiling from farther away.
_WALL_SCALE, _SLAB_SCALE = 256.0, 160.0
_PIXEL_BUDGET = 80e6  # of all textures together: a larger world has coarser ones


class Lighting(Protocol):
    """What lights panels."""

    def gain(self, panel: Panel) -> np.ndarray:
        """(rows, columns) float32 factors about 1, one per cell of a coarse grid over the panel."""
        ...


def build(
    panels: Sequence[Panel], light: Lighting, seed: int, detail: np.ndarray | float = 1.0
) -> WorldModel:
    """Paint and light every panel.

    Args:
        panels: every panel of the world.
        light: its lamps and edges.
        seed: root seed; panel k has its own stream, so that adding a panel at the end changes no other.
        detail: (len(panels),) or one for all: pixels per metre relative to the usual, at most 1.
    """
    scales = detail * np.array([_SLAB_SCALE if abs(p.normal[2]) > 0.5 else _WALL_SCALE for p in panels])
    pixels = sum(p.width_m * p.height_m * s**2 for p, s in zip(panels, scales, strict=True))
    scales *= min(1.0, np.sqrt(_PIXEL_BUDGET / pixels))
    gains = [np.ones((2, 2)) if FINISHES[p.finish].luminous else light.gain(p) for p in panels]
    areas = [p.width_m * p.height_m for p in panels]
    exposure = sum(areas) / sum(a * g.mean() for a, g in zip(areas, gains, strict=True))
    surfaces = []
    for index, (panel, scale, gain) in enumerate(zip(panels, scales, gains, strict=True)):
        rng = rng_for(seed, "world", "texture", index)
        texture = paint(panel.finish, (panel.width_m, panel.height_m), scale, rng)
        if not FINISHES[panel.finish].luminous:
            multiply(texture, exposure * gain)
        surfaces.append(panel.surface(texture))
    return WorldModel(surfaces, MEAN_LEVEL, np.ones(len(surfaces)))
