"""From pieces to a built world: one unique, lit texture per piece."""

from collections.abc import Sequence

import cv2
import numpy as np

from scenarios.seeds import rng_for
from sim.worlds.base import Surface, WorldModel
from sim.worlds.build import MEAN_LEVEL
from sim.worlds.geometry.meshes import Piece
from sim.worlds.materials.finishes import PIECE_FINISHES, draw
from sim.worlds.materials.textures import multiply

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
    surfaces: list[Surface] = []
    drawings: dict[str, np.ndarray] = {}
    for piece, scale in zip(pieces, scales, strict=True):
        texture = _texture(piece, scale, seed, drawings)
        if not PIECE_FINISHES[piece.finish].luminous:
            multiply(texture, piece.gain)
        surfaces.append(Surface(piece.vertices, piece.triangles, piece.uv, texture, piece.label))
    return WorldModel(surfaces, MEAN_LEVEL, np.ones(len(surfaces)))


def _texture(piece: Piece, scale: float, seed: int, drawings: dict[str, np.ndarray]) -> np.ndarray:
    """The piece's unlit texture; what several pieces share is drawn once and kept in ``drawings``."""
    finish, sheet = PIECE_FINISHES[piece.finish], piece.part_of
    if sheet is None:
        return draw(finish, piece.size_m, scale, rng_for(seed, "world", "piece", piece.label))
    if sheet.name not in drawings:
        rng = rng_for(seed, "world", "sheet", sheet.name)
        drawings[sheet.name] = draw(finish, sheet.size_m, scale / piece.detail, rng)
    part = _part(drawings[sheet.name], piece.size_m, sheet.corner_m, scale / piece.detail)
    if piece.detail == 1 or finish.refine is None:
        return part
    # The fine detail is the piece's own: over a shared ground, nobody sees where it ends.
    size = tuple(round(side * scale) for side in piece.size_m)
    fine = cv2.resize(part, size, interpolation=cv2.INTER_LINEAR)
    finish.refine(fine, scale, rng_for(seed, "world", "piece", piece.label))
    return fine


def _part(
    whole: np.ndarray, size_m: tuple[float, float], corner_m: tuple[float, float], scale: float
) -> np.ndarray:
    """A copy of a part of a drawing, given in metres."""
    shape = np.array(whole.shape)
    size = np.minimum(np.rint(np.array(size_m[::-1]) * scale).astype(int), shape)
    row, column = np.clip(np.rint(np.array(corner_m[::-1]) * scale).astype(int), 0, shape - size)
    return whole[row : row + size[0], column : column + size[1]].copy()
