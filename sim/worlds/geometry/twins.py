"""Twin places: parts of a world that occur again, turned by half a turn about its middle."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dslab.scenarios.worlds import Aliasing
from dslab.sim.worlds.geometry.meshes import Piece
from dslab.sim.worlds.geometry.panels import Panel
from dslab.sim.worlds.recurrence import is_there


def turned_plan(plan: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(..., 2) plan positions after half a turn about ``centre`` (2,), metres."""
    return 2 * np.asarray(centre) - plan


def turned_panel(panel: Panel, centre: np.ndarray) -> Panel:
    """The panel after half a turn about an upright axis at ``centre`` (2,); the two are twins."""
    corner = np.append(turned_plan(panel.corner[:2], centre), panel.corner[2])
    flip = np.array([-1.0, -1.0, 1.0])
    return replace(
        panel,
        corner=corner,
        right=flip * panel.right,
        down=flip * panel.down,
        label=f"{panel.label} again",
        twin=panel.twin or panel.label,
    )


def turned_piece(piece: Piece, centre: np.ndarray) -> Piece:
    """The piece, its light included, after half a turn as in ``turned_panel``."""
    vertices = piece.vertices.copy()
    vertices[:, :2] = turned_plan(vertices[:, :2], centre)
    return replace(piece, vertices=vertices, label=f"{piece.label} again", twin=piece.twin or piece.label)


def raised_panel(panel: Panel, by_m: float, name: str) -> Panel:
    """The panel again, higher by ``by_m``, its label with ``name`` behind it; the two are twins."""
    corner = panel.corner + np.array([0.0, 0.0, by_m])
    return replace(panel, corner=corner, label=f"{panel.label} {name}", twin=panel.twin or panel.label)


def with_twins(
    fixed: Sequence[Piece], things: Sequence[Piece], centre: np.ndarray, aliasing: Aliasing, seed: int
) -> list[Piece]:
    """Pieces of one half of a world, then those of the other, in which some things are missing.

    Args:
        fixed: ground, houses: always found in both halves.
        things: what stands on it.
        centre: (2,) plan position of the axis of the half turn, metres.
        aliasing: how alike the halves are.
        seed: root seed.
    """
    again = [turned_piece(piece, centre) for piece in fixed]
    again += [turned_piece(piece, centre) for piece in things if is_there(aliasing, seed, piece.label)]
    return [*fixed, *things, *again]
