"""The plan of a building: a ring of corridors, two stairwells, and the route."""

from dataclasses import dataclass

import numpy as np

from dslab.scenarios.worlds import BuildingWorld
from dslab.sim.worlds.geometry.route import arc

WALL_M = 0.15
SLAB_M = 0.35  # from a ceiling to the floor above it
CROSS_M = 1.8  # width of the passage through the core
_LANE_M, _WELL_M = 1.3, 0.3  # width of a flight, and of the gap between the two
_FOOT_M, _LANDING_M = 0.4, 1.6  # length of floor before the first step, and of the landing half way up
_TREAD_M, _RISER_M = 0.28, 0.165
_TURN_M = 0.7  # turn radius on a landing
_CLEARANCE_M = 0.5


@dataclass(frozen=True)
class Stairwell:
    """Two flights per storey side by side, with a landing half way; all storeys alike.

    Plan positions are given by ``u``, metres from the corridor into the well, and ``v``, metres from the wall
    on the right on entering to the opposite one. The lower flight is the one at ``v`` = 0.

    Attributes:
        mouth: (2,) plan position of ``u`` = ``v`` = 0.
        inward: 1 if ``u`` runs along +x and ``v`` along +y, -1 if both run the other way.
        corridor: x of the middle of the corridor that it opens on.
        storey_m: from floor to floor.
        floors: number of floors, the lowest at z = 0.
        name: for labels.
    """

    mouth: np.ndarray
    inward: float
    corridor: float
    storey_m: float
    floors: int
    name: str

    lane_m = _LANE_M
    tread_m = _TREAD_M
    width_m = 2 * _LANE_M + _WELL_M

    @property
    def steps(self) -> int:
        """Risers of a flight; the last one ends on a landing."""
        return max(3, round(self.storey_m / 2 / _RISER_M))

    @property
    def riser_m(self) -> float:
        return self.storey_m / 2 / self.steps

    @property
    def foot_m(self) -> float:
        """``u`` of the lower flight's first riser and the upper flight's last one."""
        return _FOOT_M

    @property
    def landing_m(self) -> float:
        """``u`` at which the landing half way up begins."""
        return _FOOT_M + (self.steps - 1) * _TREAD_M

    @property
    def depth_m(self) -> float:
        return self.landing_m + _LANDING_M

    def plan(self, u: float | np.ndarray, v: float | np.ndarray) -> np.ndarray:
        """(..., 2) plan position."""
        return self.mouth + self.inward * np.stack(np.broadcast_arrays(u, v), axis=-1).astype(float)

    def door(self, lane: int) -> np.ndarray:
        """(2,) middle of the corridor in front of the lower (0) or the upper (1) flight."""
        return np.array([self.corridor, self.plan(0.0, self._lane(lane))[1]])

    def climb(self, level: int) -> list[tuple[np.ndarray, float, float]]:
        """Nodes of the way up to the next floor: plan position, height, turn radius."""
        z = level * self.storey_m + np.array([0.0, 0.5, 1.0]) * self.storey_m
        low, high = self.foot_m - _TREAD_M / 2, self.landing_m + _TREAD_M / 2
        turn = self.landing_m + _LANDING_M - _TURN_M
        nodes: list[tuple[np.ndarray, float, float]] = [(self.door(0), z[0], _TURN_M)]
        for u, lane, height, radius in (
            (low, 0, z[0], 0.0),
            (high, 0, z[1], 0.0),
            (turn, 0, z[1], _TURN_M),
            (turn, 1, z[1], _TURN_M),
            (high, 1, z[1], 0.0),
            (low, 1, z[2], 0.0),
        ):
            nodes.append((self.plan(u, self._lane(lane)), height, radius))
        return [*nodes, (self.door(1), z[2], _TURN_M)]

    def _lane(self, lane: int) -> float:
        return _LANE_M / 2 if lane == 0 else self.width_m - _LANE_M / 2


@dataclass(frozen=True)
class Plan:
    """The common plan of all storeys; the ring's sides are the corridors' middle lines.

    Attributes:
        ring: (2,) extent of the ring in x and y, metres.
        half_m: half width of its corridors.
        storey_m: from floor to floor.
        clear_m: from a floor to its ceiling.
        stairs: the stairwells at x = 0 and at the far end.
    """

    ring: np.ndarray
    half_m: float
    storey_m: float
    clear_m: float
    stairs: tuple[Stairwell, Stairwell]

    @classmethod
    def of(cls, spec: BuildingWorld) -> "Plan":
        """The plan of a spec."""
        half = spec.width_m / 2
        ring = np.array([spec.length_m, 2 * half + 2 * WALL_M + Stairwell.width_m])
        near = np.array([half, half + WALL_M])
        stairs = (
            Stairwell(near, 1.0, 0.0, spec.storey_m, spec.floors, "west stairs"),
            Stairwell(ring - near, -1.0, float(ring[0]), spec.storey_m, spec.floors, "east stairs"),
        )
        return cls(ring, half, spec.storey_m, spec.storey_m - SLAB_M, stairs)

    def reach_m(self) -> float:
        """Largest reach of furniture from the walls."""
        return min(0.3, self.half_m - _CLEARANCE_M - 0.1)


def route_nodes(spec: BuildingWorld) -> tuple[np.ndarray, np.ndarray]:
    """The route's line: up the stairs, along the floors, and for a loop down again.

    Returns:
        (M, 2) plan polyline with rounded corners, closed if the spec's loop is, and (M,) its height.
    """
    plan = Plan.of(spec)
    return _rounded(_loop(spec, plan) if spec.loop else _ascent(spec, plan), spec.loop)


def walked_floors(spec: BuildingWorld) -> tuple[int, ...]:
    """Floors whose corridors the route follows; it passes the others on the stairs."""
    return (0, spec.floors - 1) if spec.loop else tuple(range(spec.floors))


def clearance_m() -> float:
    """Half width of the free space about the route."""
    return _CLEARANCE_M


_Node = tuple[np.ndarray, float, float]


def _corner(plan: Plan, east: bool, north: bool, level: int) -> _Node:
    place = plan.ring * [float(east), float(north)]
    return place, level * plan.storey_m, plan.half_m


def _ascent(spec: BuildingWorld, plan: Plan) -> list[_Node]:
    """Way from the ground floor to the end of the top floor, by alternating stairwells."""
    start = np.array([0.6 * plan.ring[0], 0.0])
    nodes: list[_Node] = [(start, 0.0, 0.0), _corner(plan, False, False, 0)]
    for level in range(spec.floors - 1):
        east = level % 2 == 1
        nodes += plan.stairs[east].climb(level)
        # Alternately by the north and by the south corridor to the other stairwell.
        north = level % 2 == 0
        nodes += [_corner(plan, east, north, level + 1), _corner(plan, not east, north, level + 1)]
    (last, height, _), (before, _, _) = nodes[-1], nodes[-2]
    back = (before - last) / np.linalg.norm(before - last)
    return [*nodes[:-1], (last + 1.5 * back, height, 0.0)]


def _loop(spec: BuildingWorld, plan: Plan) -> list[_Node]:
    """Way up the west stairs, along the top floor, down the east stairs and back."""
    top = spec.floors - 1
    west, east = plan.stairs
    up = [node for level in range(top) for node in west.climb(level)]
    down = [node for level in range(top) for node in east.climb(level)][::-1]
    across = [_corner(plan, False, True, top), _corner(plan, True, True, top)]
    return [*up, *across, *down, _corner(plan, True, False, 0), _corner(plan, False, False, 0)]


def _rounded(nodes: list[_Node], closed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Replace the nodes that are turns by arcs; between turns, lines are straight."""
    turns = [k for k, node in enumerate(nodes) if node[2] > 0]
    points, heights = [], []
    for k, (place, height, radius) in enumerate(nodes):
        if radius == 0:
            line = place[None]
        else:
            at = turns.index(k)
            before = nodes[turns[at - 1] if at > 0 or closed else 0][0]
            after = nodes[turns[(at + 1) % len(turns)] if at + 1 < len(turns) or closed else -1][0]
            line = arc(before, place, after, radius)
        points.append(line)
        heights.append(np.full(len(line), height))
    if closed:
        points.append(points[0][:1])
        heights.append(heights[0][:1])
    return np.concatenate(points), np.concatenate(heights)
