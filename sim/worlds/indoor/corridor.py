"""A corridor with right-angled turns, its walls lined with doors, pilasters, cabinets and ducts."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.seeds import rng_for
from dslab.scenarios.spec import CorridorWorld
from dslab.sim.worlds.assembly import assemble_panels
from dslab.sim.worlds.base import Route, WorldModel
from dslab.sim.worlds.geometry.panels import Box, Fitting, Panel, slab, wall
from dslab.sim.worlds.geometry.route import rounded
from dslab.sim.worlds.geometry.twins import turned_panel, turned_plan
from dslab.sim.worlds.indoor.light import Light, lamp_boxes
from dslab.sim.worlds.materials.finishes import FLOOR_FINISHES, WALL_FINISHES
from dslab.sim.worlds.recurrence import is_there

_PANEL_M, _SLAB_M = 1.8, 2.6
_BEHIND_M, _BEYOND_M = 1.5, 3.0  # least length of corridor behind the start and beyond the end of the route
_LAMP_SPACING_M = 3.2
_LONG_SHARE = (0.5, 0.6)  # of half a loop, for its longer legs
_SIDE_TOWARDS = {(1, 0): "east", (-1, 0): "west", (0, 1): "north", (0, -1): "south"}


_FITTINGS = (
    Fitting("door", 0.95, 2.05, 0.15),
    Fitting("door", 0.95, 2.05, 0.15),
    Fitting("concrete", 0.3, 99.0, 0.6),
    Fitting("cabinet", 0.9, 1.8, 1.0),
    Fitting("machine", 0.6, 0.9, 0.5, 1.1),
    Fitting("bookshelf", 0.8, 1.2, 0.8),
    Fitting("crate", 0.5, 0.5, 1.0),
)


@dataclass(frozen=True)
class _Leg:
    """One straight part.

    Attributes:
        index: from 0 at the start.
        way: (2,) unit vector along it.
        walls: left and right wall, each (2, 2): its start and end in plan.
    """

    index: int
    way: np.ndarray
    walls: dict[str, np.ndarray]

    def inward(self, side: str) -> np.ndarray:
        """(2,) unit vector from a wall into the corridor."""
        left = np.array([-self.way[1], self.way[0]])
        return -left if side == "left" else left

    def plan_box(self, side: str, at_m: tuple[float, float], reach_m: float) -> tuple[np.ndarray, np.ndarray]:
        """Plan corners, low and high, of a rectangle along a wall."""
        start, inward = self.walls[side][0], self.inward(side)
        ends = np.array([start + at_m[0] * self.way, start + at_m[1] * self.way + reach_m * inward])
        return ends.min(axis=0), ends.max(axis=0)

    def back(self, side: str) -> str:
        """The compass side of a box that touches the wall."""
        x, y = np.rint(-self.inward(side)).astype(int).tolist()
        return _SIDE_TOWARDS[x, y]


@dataclass(frozen=True)
class _Built:
    """A leg's surfaces.

    Attributes:
        shell: walls, floor and ceiling, also of the turn after it.
        boxes: everything that stands or hangs in it.
        lamps: under its ceiling.
        spots: (L, 2) plan positions of the lamps.
        walls: (2, 2, 2) plan segments of its walls.
    """

    shell: list[Panel]
    boxes: list[Box]
    lamps: list[Box]
    spots: np.ndarray
    walls: np.ndarray

    def panels(self) -> list[Panel]:
        return [*self.shell, *(face for piece in self.boxes + self.lamps for face in piece.panels())]

    def outlines(self) -> np.ndarray:
        """(S, 2, 2) plan segments of walls and of things on the floor."""
        return np.concatenate([self.walls, *(piece.outline() for piece in self.boxes if piece.low[2] == 0)])


def layout(spec: CorridorWorld, seed: int) -> Route:
    """The centre line from the origin, its corners rounded within the corridor's width.

    Raises:
        InputError: too many turns for the length, or too short for a loop.
    """
    centre = rounded(_nodes(spec, seed), radius_m=spec.width_m / 2, closed=spec.loop)
    return Route(centre, spec.width_m / 2 - _longest_reach(spec) - 0.05, spec.loop)


def build_world(spec: CorridorWorld, seed: int) -> WorldModel:
    """The corridor with its textures.

    Raises:
        InputError: too many turns for the length, or too short for a loop.
    """
    rng = rng_for(seed, "world", "corridor")
    nodes = _nodes(spec, seed)
    legs = list(_legs(spec, nodes))
    twins = spec.twins
    floor = str(rng.choice(FLOOR_FINISHES))
    panels: list[Panel] = []
    footprints, lamps = [], []
    middle = nodes.mean(axis=0)
    for leg in legs[:2] if spec.loop and twins else legs:
        if twins and not spec.loop:
            # Every other leg has the same things in the same order.
            rng = rng_for(seed, "world", "corridor", "leg", leg.index % 2)
            own = _build(spec, replace(leg, index=leg.index % 2), floor, rng)
            own_panels = [_repeated(panel, leg.index) for panel in own.panels()]
        else:
            own = _build(spec, leg, floor, rng)
            own_panels = own.panels()
        # Leg by leg: neighbours in the list are neighbours in space, so a renderer can cull them.
        panels += own_panels
        footprints.append(own.outlines())
        lamps.append(own.spots)
        if twins and spec.loop:
            there = replace(own, boxes=[piece for piece in own.boxes if is_there(twins, seed, piece.label)])
            panels += [turned_panel(panel, middle) for panel in there.panels()]
            footprints.append(turned_plan(there.outlines(), middle))
            lamps.append(turned_plan(there.spots, middle))
    if not spec.loop:
        panels += _end_walls(spec, legs, rng)
    light = Light(np.concatenate(lamps), np.concatenate(footprints), spec.height_m)
    return assemble_panels(panels, light, seed, aliasing=spec.aliased, clean=spec.surfaces == "clean")


def _build(spec: CorridorWorld, leg: _Leg, floor: str, rng: np.random.Generator) -> _Built:
    """The surfaces of a leg."""
    spots = _lamps(leg)
    boxes = _fittings(spec, leg, rng) + _duct(spec, leg, rng)
    lights = lamp_boxes(spots, spec.height_m, (leg.way[0], leg.way[1]))
    shell = _shell(spec, leg, floor, rng)
    return _Built(shell, boxes, lights, spots, np.array(list(leg.walls.values())))


def _repeated(panel: Panel, leg: int) -> Panel:
    """A panel of a leg that was built with the labels of the first leg that it repeats."""
    return panel if leg < 2 else replace(panel, label=f"{panel.label} again {leg}", twin=panel.label)


def _longest_reach(spec: CorridorWorld) -> float:
    """Largest reach of fittings from a wall, metres."""
    return min(0.35, 0.14 * spec.width_m)


def _nodes(spec: CorridorWorld, seed: int) -> np.ndarray:
    """(turns + 2, 2) corners of the centre line; turns alternate, so that no leg meets another.

    Of a loop, (4, 2), anticlockwise.
    """
    if spec.loop:
        return _block(spec, seed)
    legs = spec.turns + 1
    mean = spec.length_m / legs
    if spec.turns and mean < 2.5 * spec.width_m:
        raise InputError(
            "world: turns",
            f"legs of {mean:.1f} m are too short for a corridor {spec.width_m:g} m wide",
            "use fewer turns or a longer corridor",
        )
    rng = rng_for(seed, "world", "corridor", "plan")
    lengths = 1 + 0.15 * rng.uniform(-1, 1, legs)
    lengths *= spec.length_m / lengths.sum()
    sign = float(rng.choice([-1, 1]))
    ways = np.array([(1.0, 0.0) if k % 2 == 0 else (0.0, sign) for k in range(legs)])
    return np.vstack([np.zeros(2), np.cumsum(lengths[:, None] * ways, axis=0)])


def _block(spec: CorridorWorld, seed: int) -> np.ndarray:
    """(4, 2) corners of a loop round a block."""
    share = rng_for(seed, "world", "corridor", "plan").uniform(*_LONG_SHARE)
    long, short = share * spec.length_m / 2, (1 - share) * spec.length_m / 2
    if short < 2.5 * spec.width_m:
        least = 5 * spec.width_m / (1 - _LONG_SHARE[1])
        raise InputError(
            "world: length_m",
            f"{spec.length_m:g} m are too short for a loop of a corridor {spec.width_m:g} m wide",
            f"use at least {np.ceil(least):.0f} m or a narrower corridor",
        )
    return np.array([[0.0, 0.0], [long, 0.0], [long, short], [0.0, short]])


def _legs(spec: CorridorWorld, nodes: np.ndarray) -> Iterator[_Leg]:
    """The straight parts of the corridor; an open one reaches beyond both ends of its route."""
    if spec.loop:
        nodes = np.vstack([nodes, nodes[:1]])
    ways = np.diff(nodes, axis=0)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    left = np.column_stack([-ways[:, 1], ways[:, 0]])
    if spec.loop:
        mitre = (np.vstack([left[-1:], left]) + np.vstack([left, left[:1]])) * spec.width_m / 2
    else:
        nodes = nodes.copy()
        nodes[0] -= max(_BEHIND_M, spec.width_m / 2) * ways[0]
        nodes[-1] += max(_BEYOND_M, spec.width_m / 2) * ways[-1]
        mitre = np.vstack([left[:1], left[:-1] + left[1:], left[-1:]]) * spec.width_m / 2
    for k, way in enumerate(ways):
        ends = slice(k, k + 2)
        yield _Leg(k, way, {"left": (nodes + mitre)[ends], "right": (nodes - mitre)[ends]})


def _shell(spec: CorridorWorld, leg: _Leg, floor: str, rng: np.random.Generator) -> list[Panel]:
    """Walls, floor and ceiling of a leg and of the turn after it."""
    z = (0.0, spec.height_m)
    left, right = leg.walls["left"], leg.walls["right"]
    panels = wall(left[0], left[1], z, str(rng.choice(WALL_FINISHES)), f"left wall {leg.index}", _PANEL_M)
    panels += wall(right[1], right[0], z, str(rng.choice(WALL_FINISHES)), f"right wall {leg.index}", _PANEL_M)
    along = np.array([left @ leg.way, right @ leg.way])
    # Both walls start at the inner corner, which lies farther along, and end at the outer one.
    start, end = along[:, 0].max(), along[:, 1].max()
    corners = np.array([left[0] + (start - along[0, 0]) * leg.way, right[0] + (end - along[1, 0]) * leg.way])
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = (_SLAB_M, _SLAB_M)
    panels += slab(low, high, 0.0, True, floor, f"floor {leg.index}", size)
    return panels + slab(low, high, spec.height_m, False, "ceiling", f"ceiling {leg.index}", size)


def _end_walls(spec: CorridorWorld, legs: list[_Leg], rng: np.random.Generator) -> list[Panel]:
    z = (0.0, spec.height_m)
    first, last = legs[0].walls, legs[-1].walls
    start = wall(
        first["right"][0], first["left"][0], z, str(rng.choice(WALL_FINISHES)), "start wall", _PANEL_M
    )
    return start + wall(
        last["left"][1], last["right"][1], z, str(rng.choice(WALL_FINISHES)), "end wall", _PANEL_M
    )


def _fittings(spec: CorridorWorld, leg: _Leg, rng: np.random.Generator) -> list[Box]:
    """Fittings along both walls at irregular intervals."""
    found = []
    for side, (start, end) in leg.walls.items():
        at, length = rng.uniform(0.4, 1.0), float((end - start) @ leg.way)
        while True:
            kind = _FITTINGS[rng.integers(len(_FITTINGS))]
            if at + kind.width_m > length - 0.4:
                break
            reach = kind.reach * _longest_reach(spec)
            low, high = leg.plan_box(side, (at, at + kind.width_m), reach)
            top = kind.top_m(spec.height_m)
            hidden = (leg.back(side), "top") if top == spec.height_m else (leg.back(side),)
            label = f"{kind.finish} {side} {leg.index},{len(found)}"
            found.append(Box(np.append(low, kind.foot_m), np.append(high, top), kind.finish, label, hidden))
            at += kind.width_m + rng.uniform(0.5, 2.2)
    return found


def _duct(spec: CorridorWorld, leg: _Leg, rng: np.random.Generator) -> list[Box]:
    """A duct under the ceiling along one wall of the leg."""
    side = str(rng.choice(list(leg.walls)))
    start, end = leg.walls[side]
    length, thick = float((end - start) @ leg.way), 0.5 * _longest_reach(spec)
    pieces = int(np.ceil(length / _PANEL_M))
    z = (spec.height_m - 0.15 - thick, spec.height_m - 0.15)
    behind, ahead = (_SIDE_TOWARDS[tuple(np.rint(sign * leg.way).astype(int).tolist())] for sign in (-1, 1))
    found = []
    for k in range(pieces):
        low, high = leg.plan_box(side, (k / pieces * length, (k + 1) / pieces * length), thick)
        joints = (behind,) * (k > 0) + (ahead,) * (k < pieces - 1)
        hidden = (leg.back(side), *joints)
        found.append(
            Box(np.append(low, z[0]), np.append(high, z[1]), "pipe", f"duct {leg.index},{k}", hidden)
        )
    return found


def _lamps(leg: _Leg) -> np.ndarray:
    """(L, 2) plan positions along the middle of the leg."""
    start, end = (leg.walls["left"][k] + leg.walls["right"][k] for k in (0, 1))
    count = max(1, round(float(np.linalg.norm(end - start)) / 2 / _LAMP_SPACING_M))
    return (start + (np.arange(count)[:, None] + 0.5) / count * (end - start)) / 2
