"""Finishes of surfaces by name; a new one is a function and a line here."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from dslab.sim.worlds.geometry.car_shapes import SHAPES
from dslab.sim.worlds.materials import building_finishes as building
from dslab.sim.worlds.materials import car_finish, motifs
from dslab.sim.worlds.materials import clean_finishes as clean
from dslab.sim.worlds.materials import country_finishes as country
from dslab.sim.worlds.materials import facade_finishes as facade
from dslab.sim.worlds.materials import furniture_finishes as furniture
from dslab.sim.worlds.materials import stair_finishes as stair
from dslab.sim.worlds.materials import store_finishes as store
from dslab.sim.worlds.materials import street_finishes as street
from dslab.sim.worlds.materials.textures import fit_levels


@dataclass(frozen=True)
class Finish:
    """The painting of a surface.

    Attributes:
        draw: fills a gray image (h, w) uint8 in place, given its pixels per metre and a random stream.
        mean_level: mean gray level of the unlit texture.
        deviation: standard deviation of its gray levels.
        luminous: emits light and takes no light or shade.
        fitted: its mean and deviation are met; otherwise they are the drawing's own.
    """

    draw: Callable[[np.ndarray, float, np.random.Generator], None]
    mean_level: float
    deviation: float
    luminous: bool = False
    fitted: bool = True


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
    "bare plaster": Finish(stair.bare_plaster, 138, 24),
    "bare brick": Finish(stair.bare_brick, 112, 36),
    "bare concrete": Finish(stair.bare_concrete, 120, 28),
    "frame": Finish(stair.frame, 126, 30),
    "radiator": Finish(stair.radiator, 150, 44),
    "poster": Finish(motifs.poster, 150, 64),
    "picture": Finish(motifs.picture, 122, 48),
    "notice board": Finish(motifs.notice_board, 128, 52),
    "window": Finish(motifs.window, 172, 54, luminous=True),
    "painted": Finish(clean.painted, 142, 24),
    "small tiles": Finish(clean.small_tiles, 136, 26),
    "striped carpet": Finish(clean.striped_carpet, 84, 26),
    "smooth ceiling": Finish(clean.smooth_ceiling, 160, 8),
    "plain front": Finish(clean.plain_front, 78, 24),
    "table top": Finish(clean.table_top, 140, 40),
}
CLEAN_INSTEAD = {
    "plaster": "painted",
    "concrete": "painted",
    "boards": "painted",
    "brick": "small tiles",
    "tiles": "small tiles",
    "parquet": "striped carpet",
    "stone": "striped carpet",
    "ceiling": "smooth ceiling",
    "cabinet": "plain front",
    "machine": "plain front",
    "door": "plain front",
    "crate": "table top",
}
"""Finishes of clean surfaces, by those of worn ones that they take the place of."""
WALL_FINISHES = ("brick", "plaster", "concrete", "tiles", "boards")
FLOOR_FINISHES = ("parquet", "stone")


@dataclass(frozen=True)
class PieceFinish(Finish):
    """A finish of a mesh, whose levels may differ from piece to piece.

    Attributes:
        scale: pixels per metre where the texture budget allows.
        refine: adds detail too fine for a drawing shared by several pieces to a part of it that is seen
            from near; arguments as of ``draw``.
    """

    scale: float = 32.0
    refine: Callable[[np.ndarray, float, np.random.Generator], None] | None = None


PIECE_FINISHES = {
    "plaster front": PieceFinish(facade.plaster_front, 150, 48, scale=28, fitted=False),
    "brick front": PieceFinish(facade.brick_front, 120, 46, scale=28, fitted=False),
    "stone front": PieceFinish(facade.stone_front, 140, 44, scale=28, fitted=False),
    "gable": PieceFinish(facade.gable, 130, 30, scale=10, fitted=False),
    "asphalt": PieceFinish(street.asphalt, 100, 22, scale=36),
    "crossing": PieceFinish(street.crossing, 106, 34, scale=36),
    "paving": PieceFinish(street.paving, 132, 24, scale=36),
    "motorway": PieceFinish(street.motorway_lanes, 72, 16, scale=24),
    "meadow": PieceFinish(street.meadow, 74, 24, scale=30),
    "verge": PieceFinish(street.verge, 68, 14, scale=16),
    "metal": PieceFinish(street.metal, 128, 38, scale=60),
    "rail": PieceFinish(street.rail, 78, 38, scale=64),
    "noise wall": PieceFinish(street.noise_wall, 118, 28, scale=32),
    "bridge": PieceFinish(street.bridge, 132, 24, scale=24),
    "sign": PieceFinish(street.sign, 140, 60, scale=60),
    "tree": PieceFinish(street.tree, 78, 40, scale=48),
    "woods": PieceFinish(country.woods, 80, 24, scale=12),
    "field wall": PieceFinish(country.field_wall, 100, 36, scale=64),
    "pasture": PieceFinish(country.pasture, 76, 26, scale=18, refine=country.pasture_close),
    "rock": PieceFinish(country.rock, 122, 34, scale=64),
    "straw": PieceFinish(country.straw, 128, 34, scale=64),
    "timber": PieceFinish(country.timber, 118, 34, scale=64),
    "barn": PieceFinish(country.barn, 104, 36, scale=28),
    "far hills": PieceFinish(country.far_hills, 152, 4, scale=24),
    "clouds": PieceFinish(street.clouds, 214, 20, luminous=True, scale=20, fitted=False),
    "overcast": PieceFinish(country.overcast, 214, 10, luminous=True, scale=20, fitted=False),
    "rack": PieceFinish(store.rack, 118, 44, scale=120),
    "store floor": PieceFinish(store.floor, 128, 26, scale=90),
    "cladding": PieceFinish(store.cladding, 134, 32, scale=90),
    "steps": PieceFinish(stair.steps, 110, 34, scale=200),
    "soffit": PieceFinish(stair.bare_plaster, 140, 28, scale=110),
    "banister": PieceFinish(stair.banister, 74, 32, scale=130),
    "store roof": PieceFinish(store.roof, 128, 40, scale=24),
    **{
        name: PieceFinish(partial(car_finish.car, shape), 110, 60, scale=64, fitted=False)
        for name, shape in SHAPES.items()
    },
}


def draw(finish: Finish, size_m: tuple[float, float], scale: float, rng: np.random.Generator) -> np.ndarray:
    """Draw a texture before light and shade, (h, w) uint8; arguments as in ``paint``."""
    width, height = (max(8, round(side * scale)) for side in size_m)
    image = np.full((height, width), 128, np.uint8)
    finish.draw(image, scale, rng)
    return fit_levels(image, finish.mean_level, finish.deviation) if finish.fitted else image


def paint(finish: str, size_m: tuple[float, float], scale: float, rng: np.random.Generator) -> np.ndarray:
    """Paint a new, unlit texture.

    Args:
        finish: name in ``FINISHES``.
        size_m: width and height of the panel.
        scale: pixels per metre.
        rng: the panel's own random stream.

    Returns:
        (h, w) uint8 with the finish's mean level within 0.5.
    """
    return draw(FINISHES[finish], size_m, scale, rng)
