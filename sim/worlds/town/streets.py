"""The plan of a town: straight, axis-parallel streets and the free places along them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.seeds import rng_for
from dslab.scenarios.worlds import CityWorld
from dslab.sim.worlds.geometry.route import Stretch
from dslab.sim.worlds.geometry.twins import turned_plan

CARRIAGEWAY_M, FRONT_M = 5.0, 8.0  # from the middle of a street to its kerbs and to its houses
LANE_M = 1.5  # from the middle of a street to the middle of a lane
OVERSHOOT_M = 36.0  # streets go on beyond the corners and the ends of the route
_SIDE_DEPTH_M, _SIDE_SPACING_M = (26.0, 40.0), (48.0, 85.0)
_BETWEEN_M = 24.0  # between the fronts of streets that do not meet, for the depth of two houses
_SHORTEST_LEG_M = 60.0


@dataclass(frozen=True, eq=False)
class Street(Stretch):
    """A straight street, given by its middle line.

    Attributes:
        joined: it starts on another street; otherwise both ends are dead ends.
        main: the route follows it.
    """

    joined: bool
    main: bool

    def box(self, margin_m: float) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper plan corner of the street between its houses, grown on all sides."""
        low, high = np.minimum(self.start, self.end), np.maximum(self.start, self.end)
        return low - FRONT_M - margin_m, high + FRONT_M + margin_m


@dataclass(frozen=True)
class Plan:
    """All streets, those that own the crossings first, and the corners of the route.

    Attributes:
        streets: every street.
        corners: (M, 2) float64 corners of the route along the middle of the streets.
        closed: the route is a loop.
        turned: half a turn about the middle of its block changes nothing; the streets are then four main
            ones and pairs of a side street and its twin.
    """

    streets: tuple[Street, ...]
    corners: np.ndarray
    closed: bool
    turned: bool = False

    def first_half(self) -> tuple[Street, ...]:
        """Streets of a turned plan that, with their twins, are all of them."""
        return (*self.streets[:2], *self.streets[4::2])

    def _owns(self, street: int, other: int) -> bool:
        """The earlier street owns a crossing; of a turned block, every side owns that with the next."""
        if self.turned and street < 4 and other < 4:
            return other == (street + 1) % 4
        return street < other

    def free(
        self, street: Street, left_m: float, own_m: float, other_m: float = 0.0
    ) -> list[tuple[float, float]]:
        """Parts of a line along a street that no crossing street takes.

        Args:
            street: one of the plan's.
            left_m: the line's distance from the middle, to the left.
            own_m: half of the blocked length where this street owns the crossing.
            other_m: half of the blocked length where the other street owns it; ``own_m`` if 0.

        Returns:
            (from, to) distances along the street, metres.
        """
        rank = self.streets.index(street)
        parts = [(0.0, street.length_m)]
        for index, other in enumerate(self.streets):
            if abs(float(other.way @ street.way)) > 0.5:
                continue
            reach = sorted(
                ((other.start - street.start) @ street.left, (other.end - street.start) @ street.left)
            )
            if not reach[0] - 1e-6 <= left_m <= reach[1] + 1e-6:
                continue
            half = own_m if self._owns(rank, index) else (other_m or own_m)
            middle = float((other.start - street.start) @ street.way)
            parts = _without(parts, middle - half, middle + half)
        return parts

    def crossings(self, street: Street) -> list[float]:
        """Distances along a street at which others meet it, each once."""
        found = set()
        for other in self.streets:
            if abs(float(other.way @ street.way)) < 0.5:
                at = float((other.start - street.start) @ street.way)
                reach = sorted(
                    float(p @ street.left) for p in (other.start - street.start, other.end - street.start)
                )
                if -FRONT_M < at < street.length_m + FRONT_M and reach[0] < FRONT_M and reach[1] > -FRONT_M:
                    found.add(at)
        return sorted(found)


def plan_streets(spec: CityWorld, seed: int) -> Plan:
    """The streets of a city.

    Raises:
        InputError: too many turns for the length.
    """
    rng = rng_for(seed, "world", "city", "plan")
    corners = _block(spec, rng) if spec.loop else _zigzag(spec, rng)
    ends = np.vstack([corners, corners[:1]]) if spec.loop else corners
    streets = []
    for start, end in pairwise(ends):
        way = (end - start) / np.linalg.norm(end - start)
        streets.append(Street(start - OVERSHOOT_M * way, end + OVERSHOOT_M * way, False, True))
    turned = spec.loop and spec.twins is not None
    centre = corners.mean(axis=0) if turned else None
    for street in tuple(streets[:2] if turned else streets):
        _add_side_streets(streets, street, rng, centre)
    return Plan(tuple(streets), corners, spec.loop, turned)


def _block(spec: CityWorld, rng: np.random.Generator) -> np.ndarray:
    share = rng.uniform(0.42, 0.58)
    wide, deep = spec.length_m / 2 * share, spec.length_m / 2 * (1 - share)
    return np.array([[0.0, 0.0], [wide, 0.0], [wide, deep], [0.0, deep]])


def _zigzag(spec: CityWorld, rng: np.random.Generator) -> np.ndarray:
    """(turns + 2, 2) corners; turns alternate, so that streets meet only at corners."""
    legs = spec.turns + 1
    if spec.turns and spec.length_m / legs < _SHORTEST_LEG_M / 0.8:
        raise InputError(
            "world: turns",
            f"streets of {spec.length_m / legs:.0f} m are too short",
            f"use fewer turns or at least {_SHORTEST_LEG_M / 0.8:.0f} m per street",
        )
    lengths = 1 + 0.15 * rng.uniform(-1, 1, legs)
    lengths *= spec.length_m / lengths.sum()
    sign = float(rng.choice([-1, 1]))
    ways = np.array([(1.0, 0.0) if k % 2 == 0 else (0.0, sign) for k in range(legs)])
    return np.vstack([np.zeros(2), np.cumsum(lengths[:, None] * ways, axis=0)])


def _add_side_streets(
    streets: list[Street], parent: Street, rng: np.random.Generator, centre: np.ndarray | None
) -> None:
    """Add side streets to one or both sides at irregular intervals where there is room.

    Each is followed by its twin after half a turn about ``centre`` (2,), unless that is None.
    """
    at = OVERSHOOT_M + rng.uniform(30, 60)
    while at < parent.length_m - 20:
        for side in rng.permutation([1.0, -1.0])[: int(rng.integers(1, 3))]:
            start = parent.point(at)
            side_street = Street(start, start + side * rng.uniform(*_SIDE_DEPTH_M) * parent.left, True, False)
            if not _has_room(side_street, parent, streets):
                continue
            if centre is None:
                streets.append(side_street)
                continue
            ends = turned_plan(np.array([side_street.start, side_street.end]), centre)
            twin = Street(ends[0], ends[1], True, False)
            if _has_room(twin, streets[streets.index(parent) + 2], [*streets, side_street]):
                streets += [side_street, twin]
        at += rng.uniform(*_SIDE_SPACING_M)


def _has_room(street: Street, parent: Street, streets: list[Street]) -> bool:
    low, high = street.box(_BETWEEN_M)
    for other in streets:
        other_low, other_high = other.box(0.0)
        # A side street may continue one across the parent; otherwise streets keep their distance.
        opposite = other.joined and np.allclose(other.start, street.start)
        if other is not parent and not opposite and (low < other_high).all() and (high > other_low).all():
            return False
    return True


def _without(parts: list[tuple[float, float]], low: float, high: float) -> list[tuple[float, float]]:
    """Intervals without the part between ``low`` and ``high``; slivers are dropped."""
    left = [(a, min(b, low)) for a, b in parts] + [(max(a, high), b) for a, b in parts]
    return [(a, b) for a, b in sorted(set(left)) if b - a > 0.3]
