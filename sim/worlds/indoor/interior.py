"""The surfaces of a storey: walls with doorways, floors, ceilings, furniture."""

from dataclasses import dataclass, replace

import numpy as np

from dslab.sim.worlds.assembly import Lighting
from dslab.sim.worlds.geometry.panels import Box, Fitting, Panel, slab, wall
from dslab.sim.worlds.indoor.building_light import Lamplight
from dslab.sim.worlds.indoor.building_plan import WALL_M
from dslab.sim.worlds.indoor.light import Light, lamp_boxes
from dslab.sim.worlds.indoor.storey import OPPOSITE, Door, Side, Space, Storey
from dslab.sim.worlds.materials.finishes import FLOOR_FINISHES, WALL_FINISHES

_DOOR_HEIGHT_M, _RECESS_M, _LEAF_M = 2.08, 0.1, 0.04
_PANEL_M, _SLAB_M = 2.0, 2.6
_THIN_M = 0.012  # flat objects on a wall stand out by this much
_LAMP_SPACING_M, _LAMP_DROP_M = 3.2, 0.15
_OVER_EYES_M = 1.75


_FITTINGS = (
    Fitting("cabinet", 0.9, 1.8, 1.0),
    Fitting("concrete", 0.35, 99.0, 0.6),
    Fitting("radiator", 1.1, 0.6, 0.35, 0.14),
    Fitting("radiator", 0.8, 0.6, 0.35, 0.14),
    Fitting("machine", 0.6, 0.9, 0.4, 1.1),
    Fitting("bookshelf", 0.8, 1.3, 0.9),
    Fitting("crate", 0.45, 0.4, 1.0),
    Fitting("cabinet", 1.2, 0.8, 1.0),
)
_FURNITURE = (("bookshelf", 2.0), ("cabinet", 1.9), ("cabinet", 0.75), ("crate", 0.6), ("bookshelf", 1.2))


@dataclass(frozen=True)
class _Style:
    """Finishes of a storey, and the reach of furniture into corridors."""

    walls: tuple[str, str]
    floor: str
    reach_m: float
    clear_m: float


def storey_panels(
    storey: Storey, clear_m: float, reach_m: float, rng: np.random.Generator
) -> list[tuple[list[Panel], Lighting]]:
    """Panels of a storey whose floor is at z = 0, grouped by their light.

    The ceiling is at ``clear_m``; furniture reaches at most ``reach_m`` from a corridor's wall.
    """
    first, second = rng.choice(WALL_FINISHES, 2, replace=False).tolist()
    style = _Style((first, second), str(rng.choice(FLOOR_FINISHES)), reach_m, clear_m)
    groups = _fitted(storey.corridors, style, False, rng)
    for room in storey.rooms:
        groups += _fitted([room], style, True, rng)
    return groups


def _fitted(
    spaces: list[Space], style: _Style, is_room: bool, rng: np.random.Generator
) -> list[tuple[list[Panel], Lighting]]:
    """Panels of spaces that share their lamps: the shell and the furniture."""
    panels: list[Panel] = []
    faces: list[Panel] = []
    lamps, footprints = [], []
    for space in spaces:
        panels += _slabs(space, style)
        for side in space.sides():
            panels += _wall(space, side, style, is_room, rng)
            for low, high in space.walls(side.compass):
                footprints.append(np.array([[side.point(low), side.point(high)]]))
        boxes = _furniture(space, style, rng) if is_room else _fittings(space, style, rng)
        spots = _lamps(space)
        size = space.high - space.low
        boxes += [
            replace(box, label=f"{space.name} {box.label}")
            for box in lamp_boxes(spots, style.clear_m, (1.0, 0.0) if size[0] > size[1] else (0.0, 1.0))
        ]
        faces += [face for box in boxes for face in box.panels()]
        panels += [_window(space.side(compass), style, rng, space.name) for compass in space.windows]
        footprints += [box.outline() for box in boxes if box.low[2] == 0]
        lamps.append(spots)
    spots = np.concatenate(lamps)
    high = np.column_stack([spots, np.full(len(spots), style.clear_m - _LAMP_DROP_M)])
    shell = Light(spots, np.concatenate(footprints), style.clear_m)
    return [(panels, shell), (faces, Lamplight(high))]


def _slabs(space: Space, style: _Style) -> list[Panel]:
    size = (_SLAB_M, _SLAB_M)
    floor = slab(space.low, space.high, 0.0, True, style.floor, f"{space.name} floor", size)
    ceiling = slab(space.low, space.high, style.clear_m, False, "ceiling", f"{space.name} ceiling", size)
    return floor + ceiling


def _wall(space: Space, side: Side, style: _Style, is_room: bool, rng: np.random.Generator) -> list[Panel]:
    """A side with its doorways."""
    finish = style.walls[1] if is_room or "side" in space.name else style.walls[0]
    name = f"{space.name} {side.compass} wall"
    panels: list[Panel] = []
    for k, (low, high) in enumerate(space.walls(side.compass)):
        ends = (side.point(low), side.point(high))
        panels += wall(*ends, (0.0, style.clear_m), finish, f"{name} {k}", _PANEL_M)
    for k, door in enumerate(space.doors.get(side.compass, [])):
        panels += _doorway(side, door, finish, style, f"{name} door {k}", rng)
    return panels


def _doorway(
    side: Side, door: Door, finish: str, style: _Style, label: str, rng: np.random.Generator
) -> list[Panel]:
    """The wall over a door, its reveal, and the door, shut or open into the room."""
    low, high = door.span
    deep = WALL_M if door.open else _RECESS_M
    z, top = (0.0, _DOOR_HEIGHT_M), f"{label} lintel"
    lintel = f"bare {finish}" if finish in ("plaster", "brick", "concrete") else finish
    panels = wall(side.point(low), side.point(high), (z[1], style.clear_m), lintel, top, np.inf)
    panels += wall(side.point(low), side.point(low, deep), z, "frame", f"{label} left jamb", np.inf)
    panels += wall(side.point(high, deep), side.point(high), z, "frame", f"{label} right jamb", np.inf)
    plan = side.box(door.span, (0.0, deep))
    panels += slab(*plan, z[1], False, "frame", f"{label} head", (np.inf, np.inf))
    panels += slab(*plan, 0.0, True, "frame", f"{label} sill", (np.inf, np.inf))
    if not door.open:
        return panels + wall(
            side.point(low, deep), side.point(high, deep), z, "door", f"{label} leaf", np.inf
        )
    turn, left = np.deg2rad(rng.uniform(55, 105)), bool(rng.random() < 0.5)
    hinge = side.point(low + 0.02 if left else high - 0.02, deep)
    across = side.way if left else -side.way
    tip = hinge + (high - low - 0.04) * (np.cos(turn) * across + np.sin(turn) * side.left)
    ends = (hinge, tip) if left else (tip, hinge)
    normal = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    thick = _LEAF_M * np.array([-normal[1], normal[0]])
    panels += wall(ends[0], ends[1], z, "door", f"{label} leaf front", np.inf)
    panels += wall(ends[1] + thick, ends[0] + thick, z, "door", f"{label} leaf back", np.inf)
    edge = (tip, tip + thick) if left else (tip + thick, tip)
    return panels + wall(edge[1], edge[0], z, "frame", f"{label} leaf edge", np.inf)


def _window(side: Side, style: _Style, rng: np.random.Generator, name: str) -> Panel:
    """A bright window in the middle of a side."""
    half = min(0.85, 0.4 * side.length_m)
    middle = side.length_m / 2 + rng.uniform(-0.15, 0.15)
    ends = (side.point(middle - half, -_THIN_M), side.point(middle + half, -_THIN_M))
    z = (0.9, min(2.2, style.clear_m - 0.2))
    return wall(*ends, z, "window", f"{name} {side.compass} window", np.inf)[0]


def _fittings(space: Space, style: _Style, rng: np.random.Generator) -> list[Box]:
    """Furniture along the walls of a corridor, clear of doors, windows and junctions."""
    found = []
    for side in space.sides():
        if side.compass in space.windows:
            continue
        for low, high in space.walls(side.compass):
            # A stretch of wall ends at junctions, around whose corners the route turns.
            at = low + rng.uniform(0.25, 0.8)
            while True:
                kind = _FITTINGS[rng.integers(len(_FITTINGS))]
                if at + kind.width_m > high - 0.25:
                    break
                span = (at, at + kind.width_m)
                plan = side.box(span, (-kind.reach * style.reach_m, 0.0))
                top = kind.top_m(style.clear_m)
                hidden = (side.compass, "bottom", *(("top",) if top > _OVER_EYES_M else ()))
                label = f"{space.name} {kind.finish} {len(found)}"
                corners = (np.append(plan[0], kind.foot_m), np.append(plan[1], top))
                found.append(Box(*corners, kind.finish, label, hidden, "frame"))
                at += kind.width_m + rng.uniform(0.3, 1.6)
    return found


def _furniture(space: Space, style: _Style, rng: np.random.Generator) -> list[Box]:
    """Furniture along the walls of a room, and a table in the middle."""
    found = []
    for side in space.sides():
        if OPPOSITE[side.compass] in space.windows:
            continue  # the wall with the door, which is invisible from outside
        at = rng.uniform(0.5, 1.0)
        while at < side.length_m - 1.4:
            finish, high = _FURNITURE[rng.integers(len(_FURNITURE))]
            high = min(high, 0.8) if side.compass in space.windows else high
            wide = rng.uniform(0.6, 1.3)
            plan = side.box((at, at + wide), (-rng.uniform(0.3, 0.5), 0.0))
            label = f"{space.name} {finish} {len(found)}"
            corners = (np.append(plan[0], 0.0), np.append(plan[1], high))
            hidden = (side.compass, "top") if high > _OVER_EYES_M else (side.compass,)
            found.append(Box(*corners, finish, label, hidden, "crate"))
            at += wide + rng.uniform(0.3, 1.5)
    size = rng.uniform(0.6, 1.3, 2)
    low = (space.low + space.high - size) / 2 + rng.uniform(-0.2, 0.2, 2)
    corners = (np.append(low, 0.0), np.append(low + size, 0.75))
    return [*found, Box(*corners, "boards", f"{space.name} table", (), "crate")]


def _lamps(space: Space) -> np.ndarray:
    """(L, 2) plan positions along the longer middle line."""
    size = space.high - space.low
    axis = int(size[1] > size[0])
    count = max(1, round(float(size[axis]) / _LAMP_SPACING_M))
    spots = np.tile((space.low + space.high) / 2, (count, 1))
    spots[:, axis] = space.low[axis] + (np.arange(count) + 0.5) / count * size[axis]
    return spots
