"""Finishes by name: what a surface is made of. A new finish is a function and a line in ``FINISHES``."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim.world import building_finishes as building
from sim.world import furniture_finishes as furniture
from sim.world.textures import fit_levels


@dataclass(frozen=True)
class Finish:
    """How a surface is painted.

    Attributes:
        draw: fills a gray image (h, w) uint8 in place, given its pixels per metre and a random stream.
        mean_level: mean gray level of the unlit texture.
        deviation: standard deviation of its gray levels.
        luminous: shines itself and takes no light or shade.
    """

    draw: Callable[[np.ndarray, float, np.random.Generator], None]
    mean_level: float
    deviation: float
    luminous: bool = False


FINISHES = {
    "brick": Finish(building.brick, 108, 40),
    "plaster": Finish(building.plaster, 148, 36),
    "concrete": Finish(building.concrete, 124, 36),
    "tiles": Finish(building.tiles, 140, 40),
    "boards": Finish(building.boards, 100, 40),
    "parquet": Finish(building.parquet, 92, 34),
    "stone": Finish(building.stone, 112, 34),
    "ceiling": Finish(building.ceiling, 168, 30),
    "lamp": Finish(building.lamp, 238, 8, luminous=True),
    "bookshelf": Finish(furniture.bookshelf, 98, 48),
    "cabinet": Finish(furniture.cabinet, 126, 38),
    "crate": Finish(furniture.crate, 132, 38),
    "machine": Finish(furniture.machine, 116, 46),
    "door": Finish(furniture.door, 122, 40),
    "pipe": Finish(furniture.pipe, 140, 40),
}
WALL_FINISHES = ("brick", "plaster", "concrete", "tiles", "boards")
FLOOR_FINISHES = ("parquet", "stone")


def paint(finish: str, size_m: tuple[float, float], scale: float, rng: np.random.Generator) -> np.ndarray:
    """A new, unlit texture.

    Args:
        finish: name in ``FINISHES``.
        size_m: width and height of the panel.
        scale: pixels per metre.
        rng: the panel's own random stream.

    Returns:
        (h, w) uint8 with the finish's mean level within 0.5.
    """
    width, height = (max(8, round(side * scale)) for side in size_m)
    image = np.full((height, width), 128, np.uint8)
    kind = FINISHES[finish]
    kind.draw(image, scale, rng)
    return fit_levels(image, kind.mean_level, kind.deviation)
