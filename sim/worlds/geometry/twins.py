"""Twin places: parts of a world that occur again, turned by half a turn about its middle."""

from dataclasses import replace

import numpy as np

from sim.worlds.geometry.meshes import Piece
from sim.worlds.geometry.panels import Panel


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
