"""A furnished room: furniture at the walls, an island, and a walkable ring between."""

import numpy as np

from dslab.scenarios.seeds import rng_for
from dslab.scenarios.spec import RoomWorld
from dslab.sim.worlds.assembly import assemble_panels
from dslab.sim.worlds.base import Route, WorldModel
from dslab.sim.worlds.geometry.panels import Box, Panel, slab, wall
from dslab.sim.worlds.geometry.route import rounded
from dslab.sim.worlds.geometry.twins import turned_panel, turned_plan
from dslab.sim.worlds.indoor.light import Light, lamp_boxes
from dslab.sim.worlds.materials.finishes import FLOOR_FINISHES, WALL_FINISHES
from dslab.sim.worlds.recurrence import is_there

_PANEL_M = 1.9
_MIDDLE = np.zeros(2)
_LARGEST_DEPTH_M, _WIDEST_RING_M = 0.6, 2.6
_HEIGHTS_M = (0.75, 0.9, 1.3, 1.8, 2.1)
_FURNITURE = ("bookshelf", "cabinet", "machine", "crate")


def layout(spec: RoomWorld, seed: int) -> Route:
    """Route around the island, between it and the furniture at the walls, for every seed."""
    del seed
    x, y = _half(spec) - _furniture_depth(spec) - _ring_width(spec) / 2
    corners = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    centre = rounded(corners, radius_m=_ring_width(spec) / 2, closed=True)
    return Route(centre, _ring_width(spec) / 2 - 0.05, True)


def build_world(spec: RoomWorld, seed: int) -> WorldModel:
    """The room with its textures."""
    rng = rng_for(seed, "world", "room")
    half = _half(spec)
    twins = spec.twins
    corners = half * [[-1, -1], [-1, 1], [1, 1], [1, -1]]
    sides = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    panels: list[Panel] = []
    for side, (start, end) in enumerate(sides):
        finish = str(rng.choice(WALL_FINISHES))
        if side < 2 or not twins:
            panels += wall(start, end, (0, spec.height_m), finish, f"wall {side}", _PANEL_M)
    # The southern half of a room whose northern half is its twin.
    north = np.array([half[0], 0.0]) if twins else half
    size = (_PANEL_M, _PANEL_M)
    panels += slab(-half, north, 0.0, True, str(rng.choice(FLOOR_FINISHES)), "floor", size)
    panels += slab(-half, north, spec.height_m, False, "ceiling", "ceiling", size)
    along_walls, island = _along_walls(spec, rng), _island(spec, rng)
    furniture = [piece for cell in island.values() for piece in cell]
    furniture = [*(piece for side in along_walls.values() for piece in side), *furniture]
    footprints = [sides]
    if twins:
        furniture = along_walls["south"] + along_walls["west"] + _first_of_pairs(island)
        panels += [turned_panel(panel, _MIDDLE) for panel in panels]
        for piece in furniture:
            if is_there(twins, seed, piece.label):
                panels += [turned_panel(panel, _MIDDLE) for panel in piece.panels()]
                footprints += [turned_plan(piece.outline(), _MIDDLE)] if piece.low[2] == 0 else []
    lamps = _lamps(spec)
    for piece in furniture + lamp_boxes(lamps, spec.height_m, (1.0, 0.0)):
        panels += piece.panels()
    footprints += [piece.outline() for piece in furniture if piece.low[2] == 0]
    light = Light(lamps, np.concatenate(footprints), spec.height_m)
    return assemble_panels(panels, light, seed, aliasing=spec.aliased, clean=spec.surfaces == "clean")


def _half(spec: RoomWorld) -> np.ndarray:
    return np.array([spec.length_m, spec.width_m]) / 2


def _furniture_depth(spec: RoomWorld) -> float:
    return min(_LARGEST_DEPTH_M, 0.11 * min(spec.length_m, spec.width_m))


def _ring_width(spec: RoomWorld) -> float:
    return min(_WIDEST_RING_M, 0.26 * min(spec.length_m, spec.width_m))


def _lamps(spec: RoomWorld) -> np.ndarray:
    """(L, 2) plan positions on a grid."""
    counts = np.maximum(1, np.rint(2 * _half(spec) / 3.5)).astype(int)
    cells = np.stack(np.meshgrid(*(np.arange(n) for n in counts)), axis=-1).reshape(-1, 2)
    return (2 * (cells + 0.5) / counts - 1) * _half(spec)


def _along_walls(spec: RoomWorld, rng: np.random.Generator) -> dict[str, list[Box]]:
    """Furniture of all heights with its back to the walls, with gaps, by side."""
    depth, half = _furniture_depth(spec), _half(spec)
    pieces: list[Box] = []
    by_side: dict[str, list[Box]] = {}
    for side, axis, sign in (("south", 0, -1), ("north", 0, 1), ("west", 1, -1), ("east", 1, 1)):
        at, stop = -half[axis] + depth + 0.2, half[axis] - depth - 0.3
        while at < stop - 0.6:
            wide, deep = min(rng.uniform(0.6, 1.7), stop - at), depth * rng.uniform(0.6, 1.0)
            back = sign * half[1 - axis]
            low, high = np.zeros(3), np.full(3, min(spec.height_m - 0.4, float(rng.choice(_HEIGHTS_M))))
            low[axis], high[axis] = at, at + wide
            low[1 - axis], high[1 - axis] = sorted((back, back - sign * deep))
            finish = str(rng.choice(_FURNITURE))
            pieces.append(Box(low, high, finish, f"{finish} {side} {len(pieces)}", (side,), "crate"))
            at += wide + rng.uniform(0.1, 1.4)
        by_side[side] = [piece for piece in pieces if piece.hidden == (side,)]
    return by_side


def _island(spec: RoomWorld, rng: np.random.Generator) -> dict[tuple[int, ...], list[Box]]:
    """Furniture on a grid in the middle of the room, some with a crate on top, by cell."""
    reach = _half(spec) - _furniture_depth(spec) - _ring_width(spec)
    cells = np.maximum(1, np.floor(2 * reach / 1.4)).astype(int)
    size = 2 * reach / cells
    by_cell: dict[tuple[int, ...], list[Box]] = {}
    for cell in np.ndindex(*cells):
        pieces = by_cell[cell] = []
        if rng.random() < 0.25 and cells.prod() > 1:
            continue
        extent = size * rng.uniform(0.5, 0.85, 2)
        corner = -reach + size * cell + (size - extent) * rng.random(2)
        height = min(spec.height_m - 0.9, float(rng.choice((0.5, 0.8, 1.1, 1.4, 1.9))))
        finish = str(rng.choice(_FURNITURE))
        label = f"{finish} island {cell[0]},{cell[1]}"
        high = np.append(corner + extent, height)
        pieces.append(Box(np.append(corner, 0.0), high, finish, label, (), "crate"))
        if rng.random() < 0.5:
            small = extent * rng.uniform(0.3, 0.6, 2)
            low = np.append(corner + (extent - small) * rng.random(2), height)
            high = low + np.append(small, rng.uniform(0.2, 0.45))
            pieces.append(Box(low, high, "crate", f"{label} load", ("bottom",)))
    return by_cell


def _first_of_pairs(cells: dict[tuple[int, ...], list[Box]]) -> list[Box]:
    """Furniture of the cells that come before the one opposite; one in the middle stays empty."""
    ends = np.max(list(cells), axis=0)
    return [piece for cell, own in cells.items() if cell < tuple(ends - cell) for piece in own]
