"""Assembly of worlds: one unique, lit texture per panel or piece."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import cv2
import numpy as np

from dslab.scenarios.seeds import rng_for
from dslab.scenarios.worlds import Aliasing
from dslab.sim.worlds.base import Surface, WorldModel
from dslab.sim.worlds.geometry.meshes import Piece
from dslab.sim.worlds.geometry.panels import Panel
from dslab.sim.worlds.materials.finishes import CLEAN_INSTEAD, FINISHES, PIECE_FINISHES, draw, paint
from dslab.sim.worlds.materials.textures import multiply
from dslab.sim.worlds.recurrence import Recurrence

# The level to which every texture fades. One for all: without contrast, surfaces meet without an edge.
MEAN_LEVEL = 118.0
# Texture detail in pixels per metre: a wall is seen from 1 m, floor and ceiling from farther away.
_WALL_SCALE, _SLAB_SCALE = 256.0, 160.0
# Texture pixels of a whole world: a larger world has coarser textures.
_PANEL_BUDGET_PX, _PIECE_BUDGET_PX = 80e6, 36e6
# Panels of these finishes may show one another's pictures, of any size.
_INTERCHANGEABLE = tuple(
    name for name, finish in FINISHES.items() if not finish.luminous and name not in CLEAN_INSTEAD.values()
)


class Lighting(Protocol):
    """Light that falls on panels."""

    def gain(self, panel: Panel) -> np.ndarray:
        """(rows, columns) float32 factors about 1, one per cell of a coarse grid over the panel."""
        ...


def assemble_panels(
    panels: Sequence[Panel],
    light: Lighting,
    seed: int,
    detail: np.ndarray | float = 1.0,
    aliasing: Aliasing | None = None,
    clean: bool = False,
) -> WorldModel:
    """Paint and light every panel.

    Args:
        panels: every panel of the world.
        light: its lamps and edges.
        seed: root seed; panel k has its own stream, so that adding a panel at the end changes no other.
        detail: (len(panels),) or one for all: pixels per metre relative to the usual, at most 1.
        aliasing: what occurs again; None: every texture is unique.
        clean: surfaces without wear take the place of worn ones.
    """
    if clean:
        panels = [replace(p, finish=CLEAN_INSTEAD.get(p.finish, p.finish)) for p in panels]
    sizes_m = [(panel.width_m, panel.height_m) for panel in panels]
    scales = detail * np.array([_SLAB_SCALE if abs(p.normal[2]) > 0.5 else _WALL_SCALE for p in panels])
    scales = _within_budget(scales, sizes_m, _PANEL_BUDGET_PX)
    gains = [np.ones((2, 2)) if FINISHES[p.finish].luminous else light.gain(p) for p in panels]
    areas = [width_m * height_m for width_m, height_m in sizes_m]
    exposure = sum(areas) / sum(a * g.mean() for a, g in zip(areas, gains, strict=True))
    again = Recurrence(aliasing, seed, paint, _INTERCHANGEABLE) if aliasing else None
    surfaces = []
    for index, (panel, size_m, scale, gain) in enumerate(zip(panels, sizes_m, scales, gains, strict=True)):
        if again:
            texture = again.texture(panel.label, panel.twin, panel.finish, size_m, scale)
        else:
            texture = paint(panel.finish, size_m, scale, rng_for(seed, "world", "texture", index))
        if not FINISHES[panel.finish].luminous:
            multiply(texture, exposure * gain)
        surfaces.append(panel.surface(texture))
    return _world(surfaces)


def assemble_pieces(pieces: Sequence[Piece], seed: int, aliasing: Aliasing | None = None) -> WorldModel:
    """Paint and light every piece.

    Args:
        pieces: every piece of the world.
        seed: root seed; a piece's stream is named by its label.
        aliasing: what occurs again; None: every texture is unique.
    """
    again = Recurrence(aliasing, seed, _drawn) if aliasing else None
    scales = np.array([PIECE_FINISHES[p.finish].scale * p.detail for p in pieces])
    scales = _within_budget(scales, [piece.size_m for piece in pieces], _PIECE_BUDGET_PX)
    surfaces = []
    drawings: dict[str, np.ndarray] = {}
    for piece, scale in zip(pieces, scales, strict=True):
        if again and piece.part_of is None:
            texture = again.texture(piece.label, piece.twin, piece.finish, piece.size_m, scale)
        else:
            named = replace(piece, label=again.source(piece.label, piece.twin)) if again else piece
            texture = _texture(named, scale, seed, drawings)
        if not PIECE_FINISHES[piece.finish].luminous:
            multiply(texture, piece.gain)
        surfaces.append(Surface(piece.vertices, piece.triangles, piece.uv, texture, piece.label))
    return _world(surfaces)


def _within_budget(
    scales: np.ndarray, sizes_m: Sequence[tuple[float, float]], budget_px: float
) -> np.ndarray:
    """(n,) pixels per metre, all lowered alike until the textures together keep to the budget."""
    pixels = sum(width_m * height_m * s**2 for (width_m, height_m), s in zip(sizes_m, scales, strict=True))
    return scales * min(1.0, np.sqrt(budget_px / pixels))


def _world(surfaces: list[Surface]) -> WorldModel:
    return WorldModel(surfaces, MEAN_LEVEL, np.ones(len(surfaces)))


def _drawn(finish: str, size_m: tuple[float, float], scale: float, rng: np.random.Generator) -> np.ndarray:
    """A new texture of a mesh, its finish given by name."""
    return draw(PIECE_FINISHES[finish], size_m, scale, rng)


def _texture(piece: Piece, scale: float, seed: int, drawings: dict[str, np.ndarray]) -> np.ndarray:
    """The piece's unlit texture; ``drawings`` keeps sheets that pieces share."""
    finish, sheet = PIECE_FINISHES[piece.finish], piece.part_of
    if sheet is None:
        return draw(finish, piece.size_m, scale, rng_for(seed, "world", "piece", piece.label))
    if sheet.name not in drawings:
        rng = rng_for(seed, "world", "sheet", sheet.name)
        drawings[sheet.name] = draw(finish, sheet.size_m, scale / piece.detail, rng)
    part = _part(drawings[sheet.name], piece.size_m, sheet.corner_m, scale / piece.detail)
    if piece.detail == 1 or finish.refine is None:
        return part
    # The fine detail is the piece's own; its end does not show on shared ground.
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
