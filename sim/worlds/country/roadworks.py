"""Structures along a motorway: guard rails, gantries, bridges, noise walls."""

import numpy as np

from dslab.sim.worlds.geometry.meshes import Mesh, Piece, block, grid_triangles
from dslab.sim.worlds.geometry.outdoor import Daylight
from dslab.sim.worlds.geometry.route import Stretch, arc_length
from dslab.sim.worlds.geometry.street_furniture import hung_sign

# A beam in the shape of a W: distance from the posts and height, from the top down.
_BEAM_M = np.array(
    [[0.0, 0.75], [0.08, 0.70], [0.08, 0.66], [0.0, 0.6], [0.08, 0.54], [0.08, 0.5], [0.0, 0.45]]
)
_POST_EVERY_M = 5.0
_DECK_M, _CLEAR_M = (9.0, 1.1), 5.6  # width and depth of a bridge, and the height under it
_PIER_M, _PARAPET_M = (0.9, 1.6), 1.0
_BEAM_HEIGHT_M, _GANTRY_DEPTH_M = 6.4, 0.5
_WALL_M, _WALL_POST_M = 3.6, 0.18


def guard_rail(ends: np.ndarray, label: str, gain: np.ndarray) -> Piece:
    """A guard rail on posts between two plan points (2, 2), both of its faces alike."""
    line, mesh = Stretch(*ends), Mesh()
    length, along, aside = line.length_m, line.way, line.left
    deep = arc_length(_BEAM_M)
    for side, (a, b) in ((1.0, ends[::-1]), (-1.0, ends)):
        rows = [
            [np.append(foot + side * out * aside, high) for foot in (a, b)] for out, high in _BEAM_M.tolist()
        ]
        sheet = [[[u, v] for u in (0.0, length)] for v in deep.tolist()]
        mesh.add(np.reshape(rows, (-1, 3)), grid_triangles(len(deep), 2), np.reshape(sheet, (-1, 2)))
    for at in np.arange(0.5 * _POST_EVERY_M, length, _POST_EVERY_M).tolist():
        foot = np.append(ends[0] + at * along, 0.0)
        block(mesh, foot, along, (0.14, 0.1, 0.72), (at, float(deep[-1])), 0.4)
    return Piece.of(mesh, (length, float(deep[-1]) + 0.3), "rail", label, gain)


def gantry(
    left: np.ndarray, right: np.ndarray, facing: np.ndarray, label: str, rng: np.random.Generator
) -> list[Piece]:
    """A beam over a carriageway on posts at two plan positions (2,), with signs turned ``facing`` (2,)."""
    mesh, wide = Mesh(), float(np.linalg.norm(right - left))
    across = (right - left) / wide
    for foot in (left, right):
        block(mesh, np.append(foot, 0.0), across, (0.45, 0.45, _BEAM_HEIGHT_M), (0.0, 0.0), 0.4)
    middle = np.append((left + right) / 2, _BEAM_HEIGHT_M)
    block(mesh, middle, across, (wide + 0.5, _GANTRY_DEPTH_M, 0.9), (0.0, 0.2), 0.25)
    pieces = [Piece.of(mesh, (4.0, 3.0), "metal", label)]
    lanes = int(rng.integers(2, 4))
    for k in range(lanes):
        size = (0.8 * wide / lanes, rng.uniform(1.8, 2.7))
        spot = left + (k + 0.5) / lanes * (right - left) + 0.35 * facing
        centre = np.append(spot, _BEAM_HEIGHT_M + rng.uniform(0.4, 0.8))
        pieces.append(hung_sign(centre, facing, size, f"{label} sign {k}"))
    return pieces


def bridge(
    start: np.ndarray, end: np.ndarray, piers: list[np.ndarray], label: str, light: Daylight
) -> list[Piece]:
    """A bridge of concrete between two plan positions (2,), on piers (2,); ``light`` takes its shadow."""
    line = Stretch(start, end)
    length, along, aside = line.length_m, line.way, line.left
    wide, deep = _DECK_M
    middle = np.append((start + end) / 2, _CLEAR_M)
    deck = Mesh()
    block(deck, middle, along, (length, wide, deep), (0.0, 0.0))
    pieces = [Piece.of(deck, (length, wide), "bridge", label)]
    parapet = Mesh()
    for side in (1.0, -1.0):
        edge = middle + np.append(side * (wide / 2 - 0.1) * aside, deep)
        block(parapet, edge, along, (length, 0.2, _PARAPET_M), (0.0, 0.0))
    pieces.append(Piece.of(parapet, (length, _PARAPET_M), "bridge", f"{label} parapet"))
    for k, foot in enumerate(piers):
        pier = Mesh()
        block(pier, np.append(foot, 0.0), aside, (*_PIER_M[::-1], _CLEAR_M), (0.0, 0.0))
        pieces.append(Piece.of(pier, (_PIER_M[1] + 0.2, _CLEAR_M), "bridge", f"{label} pier {k}"))
    corners = [p + side * wide / 2 * aside for p, side in ((start, 1), (end, 1), (end, -1), (start, -1))]
    light.shade_polygon(np.array(corners), _CLEAR_M + deep)
    return pieces


def noise_wall(ends: np.ndarray, label: str, gain: np.ndarray) -> Piece:
    """A wall of panels between posts, between two plan points (2, 2), seen from both sides."""
    line, mesh = Stretch(*ends), Mesh()
    length, along = line.length_m, line.way
    block(mesh, np.append(ends.mean(axis=0), -0.1), along, (length, 0.12, _WALL_M + 0.1), (0.0, 0.0))
    for at in np.arange(0.0, length, _POST_EVERY_M).tolist():
        foot = np.append(ends[0] + at * along, 0.0)
        block(mesh, foot, along, (_WALL_POST_M, 0.3, _WALL_M + 0.15), (at, 0.0), 0.9)
    return Piece.of(mesh, (length, _WALL_M + 0.1), "noise wall", label, gain)
