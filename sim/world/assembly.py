"""From pieces to a built world: one unique, lit texture per piece."""

from collections.abc import Sequence

import numpy as np

from scenarios.seeds import rng_for
from sim.world.base import Surface, WorldModel
from sim.world.build import MEAN_LEVEL
from sim.world.finishes import PIECE_FINISHES, draw
from sim.world.meshes import Piece
from sim.world.textures import multiply

_PIXEL_BUDGET = 36e6  # of all textures together: a larger world has coarser ones


def assemble(pieces: Sequence[Piece], seed: int) -> WorldModel:
    """Paint and light every piece.

    Args:
        pieces: every piece of the world.
        seed: root seed; a piece's stream is named by its label.
    """
    scales = np.array([PIECE_FINISHES[p.finish].scale * p.detail for p in pieces])
    pixels = sum(p.size_m[0] * p.size_m[1] * s**2 for p, s in zip(pieces, scales, strict=True))
    scales *= min(1.0, np.sqrt(_PIXEL_BUDGET / pixels))
    surfaces = []
    for piece, scale in zip(pieces, scales, strict=True):
        rng = rng_for(seed, "world", "piece", piece.label)
        texture = draw(PIECE_FINISHES[piece.finish], piece.size_m, scale, rng)
        if not PIECE_FINISHES[piece.finish].luminous:
            multiply(texture, piece.gain)
        surfaces.append(Surface(piece.vertices, piece.triangles, piece.uv, texture, piece.label))
    return WorldModel(surfaces, MEAN_LEVEL, np.ones(len(surfaces)))
