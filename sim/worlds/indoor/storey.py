"""One storey: corridors with junctions, doors, and rooms behind open doors."""

from dataclasses import dataclass, field

import numpy as np

from dslab.sim.worlds.geometry.route import Stretch
from dslab.sim.worlds.indoor.building_plan import CROSS_M, WALL_M, Plan

_DOOR_M, _STUB_M = 0.95, 1.8
_OPEN_SHARE = 0.35
_ROOM_WIDTH_M, _ROOM_DEPTH_M = (2.8, 4.4), (2.4, 3.6)

OPPOSITE = {"west": "east", "north": "south", "east": "west", "south": "north"}


@dataclass(frozen=True, eq=False)
class Side(Stretch):
    """A side of a rectangle as seen from inside, with ``start`` on the left and ``left`` pointing outward.

    ``compass`` says which side it is.
    """

    compass: str

    def box(self, span: tuple[float, float], out_m: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner of the rectangle between two distances along and two outward."""
        ends = np.array([self.point(span[0], out_m[0]), self.point(span[1], out_m[1])])
        return ends.min(axis=0), ends.max(axis=0)


@dataclass(frozen=True)
class Door:
    """A doorway from ``span[0]`` to ``span[1]`` along a side."""

    span: tuple[float, float]
    open: bool


@dataclass
class Space:
    """A rectangular corridor or room.

    Attributes:
        low, high: (2,) plan corners, metres.
        name: unique in the storey.
        gaps: per side, spans where it is open to a neighbour over the full height.
        doors: per side.
        windows: sides with a window in their middle.
    """

    low: np.ndarray
    high: np.ndarray
    name: str
    gaps: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    doors: dict[str, list[Door]] = field(default_factory=dict)
    windows: tuple[str, ...] = ()

    def sides(self) -> list[Side]:
        """West, north, east and south side."""
        (x0, y0), (x1, y1) = self.low, self.high
        corners = np.array([[x0, y0], [x0, y1], [x1, y1], [x1, y0]])
        names = ("west", "north", "east", "south")
        return [Side(corners[k], corners[(k + 1) % 4], name) for k, name in enumerate(names)]

    def side(self, compass: str) -> Side:
        return next(side for side in self.sides() if side.compass == compass)

    def walls(self, compass: str) -> list[tuple[float, float]]:
        """Spans of a side that are wall over the full height, in order."""
        open_spans = self.gaps.get(compass, []) + [door.span for door in self.doors.get(compass, [])]
        return uncovered(self.side(compass).length_m, open_spans)


@dataclass(frozen=True)
class Storey:
    """The spaces of a storey, with rooms only behind open doors."""

    corridors: list[Space]
    rooms: list[Space]


def uncovered(length_m: float, spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Parts of [0, length] outside all spans, in order; slivers are left out."""
    free, at = [], 0.0
    for low, high in [*sorted(spans), (length_m, length_m)]:
        if low - at > 1e-6:
            free.append((at, low))
        at = max(at, high)
    return free


def plan_storey(plan: Plan, walked: bool, rng: np.random.Generator) -> Storey:
    """Plan a storey: its side corridors, its rooms and their doors, which are closed unless it is walked."""
    ring = _ring(plan)
    cross_x = plan.ring[0] / 2 + rng.uniform(-0.5, 0.5) * max(0.0, _core_m(plan) - CROSS_M - 1.0)
    half = np.array([CROSS_M / 2, 0.0])
    ends = np.array([[cross_x, plan.half_m], [cross_x, plan.ring[1] - plan.half_m]])
    cross = Space(ends[0] - half, ends[1] + half, "passage")
    stubs = [*_outer_stubs(plan, rng), *_end_stubs(plan, rng)]
    corridors = [*ring, cross, *stubs]
    for one in corridors:
        for other in corridors:
            if one is not other:
                _open_between(one, other.low, other.high)
    for stairs in plan.stairs:
        ends = np.sort(stairs.plan(np.array([0.0, 1.0]), np.array([0.0, stairs.width_m])), axis=0)
        for corridor in ring:
            _open_between(corridor, ends[0], ends[1])
    rooms: list[Space] = []
    for corridor, compass in ((ring[0], "south"), (ring[1], "north")):
        rooms += _rooms_along(corridor, compass, walked, rng)
    for corridor, compass in ((ring[0], "north"), (ring[1], "south")):
        _closed_doors(plan, corridor, compass, rng)
    return Storey(corridors, rooms)


def _core_m(plan: Plan) -> float:
    """Length of the core between the two stairwells."""
    return float(plan.ring[0] - 2 * (plan.half_m + plan.stairs[0].depth_m + WALL_M))


def _ring(plan: Plan) -> list[Space]:
    """South, north, west and east corridor; the corners belong to the long ones."""
    (x, y), h = plan.ring, plan.half_m
    return [
        Space(np.array([-h, -h]), np.array([x + h, h]), "south corridor"),
        Space(np.array([-h, y - h]), np.array([x + h, y + h]), "north corridor"),
        Space(np.array([-h, h]), np.array([h, y - h]), "west corridor"),
        Space(np.array([x - h, h]), np.array([x + h, y - h]), "east corridor"),
    ]


def _outer_stubs(plan: Plan, rng: np.random.Generator) -> list[Space]:
    """Side corridors to the outside, one or two per long corridor, ending at a window."""
    (length, y), h = plan.ring, plan.half_m
    stubs = []
    for north in (False, True):
        count = int(rng.integers(1, 3)) + int(length > 40)
        room = length / count
        for k in range(count):
            x = (k + rng.uniform(0.2, 0.8)) * room
            deep, half = rng.uniform(3.0, 5.5), _STUB_M / 2
            low, high = (y + h, y + h + deep) if north else (-h - deep, -h)
            compass = "north" if north else "south"
            stubs.append(
                Space(
                    np.array([x - half, low]),
                    np.array([x + half, high]),
                    f"{compass} side corridor {k}",
                    windows=(compass,),
                )
            )
    return stubs


def _end_stubs(plan: Plan, rng: np.random.Generator) -> list[Space]:
    """Extensions of some ends of the long corridors beyond the ring, up to a window."""
    (x, y), h = plan.ring, plan.half_m
    stubs = []
    for north in (False, True):
        for east in (False, True):
            deep = rng.uniform(1.5, 4.5)
            if rng.random() < 0.4:
                continue
            middle = y if north else 0.0
            low, high = (x + h, x + h + deep) if east else (-h - deep, -h)
            name = f"{'north' if north else 'south'} {'east' if east else 'west'} end"
            ends = (np.array([low, middle - h]), np.array([high, middle + h]))
            stubs.append(Space(*ends, name, windows=("east" if east else "west",)))
    return stubs


def _open_between(space: Space, low: np.ndarray, high: np.ndarray) -> None:
    """Open a corridor towards a rectangle that touches it."""
    for side in space.sides():
        out = ((np.array([low, high]) - side.start) @ side.left).tolist()
        if min(abs(out[0]), abs(out[1])) > 1e-6 or max(out) < 1e-6:
            continue
        along = sorted(((np.array([low, high]) - side.start) @ side.way).tolist())
        span = (max(0.0, along[0]), min(side.length_m, along[1]))
        if span[1] - span[0] > 1e-6:
            space.gaps.setdefault(side.compass, []).append(span)


def _rooms_along(corridor: Space, compass: str, walked: bool, rng: np.random.Generator) -> list[Space]:
    """Rooms side by side along the free stretches of a side, each with a door."""
    side, rooms = corridor.side(compass), []
    for low, high in corridor.walls(compass):
        # Side corridors need their walls.
        at, stop = low + WALL_M, high - WALL_M
        while stop - at > _ROOM_WIDTH_M[0]:
            wide = float(rng.uniform(*_ROOM_WIDTH_M))
            if stop - at - wide < _ROOM_WIDTH_M[0]:
                wide = stop - at
            place = at + rng.uniform(0.25, max(0.26, wide - _DOOR_M - 0.25))
            door = Door((place, place + _DOOR_M), bool(rng.random() < _OPEN_SHARE) and walked)
            corridor.doors.setdefault(compass, []).append(door)
            if door.open:
                deep = float(rng.uniform(*_ROOM_DEPTH_M))
                ends = side.box((at, at + wide - WALL_M), (WALL_M, WALL_M + deep))
                rooms.append(Space(*ends, f"{compass} room {len(rooms)}", windows=(compass,)))
            at += wide
    return rooms


def _closed_doors(plan: Plan, corridor: Space, compass: str, rng: np.random.Generator) -> None:
    """Closed doors to the core, with none at the stairwells' sides."""
    side = corridor.side(compass)
    first = plan.stairs[0].depth_m + 2 * plan.half_m + WALL_M
    for low, high in corridor.walls(compass):
        at = max(low, first) + rng.uniform(0.3, 1.2)
        while at + _DOOR_M + 0.3 < min(high, side.length_m - first):
            corridor.doors.setdefault(compass, []).append(Door((at, at + _DOOR_M), False))
            at += _DOOR_M + rng.uniform(1.2, 3.5)
