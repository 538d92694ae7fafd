"""Hilly pasture about a level ring, with walls, trees, hedges, stones, bales, barns."""

from itertools import pairwise

import numpy as np

from dslab.scenarios.seeds import rng_for
from dslab.scenarios.worlds import FieldWorld
from dslab.sim.worlds.assembly import assemble_pieces
from dslab.sim.worlds.base import Route, WorldModel
from dslab.sim.worlds.country.farm import bale, barn, fence, fence_feet, field_wall, stone
from dslab.sim.worlds.country.terrain import Relief, Tiling
from dslab.sim.worlds.geometry.meshes import Piece
from dslab.sim.worlds.geometry.outdoor import Daylight, Sky
from dslab.sim.worlds.geometry.plants import bush, conifer, hedge, ragged_woods, tree
from dslab.sim.worlds.geometry.route import arc_length, rounded
from dslab.sim.worlds.geometry.twins import with_twins

_CLEARANCE_M = 1.5
_RING_SHARE = 0.33  # of the size, from the middle to the route
_TILE_M, _MOST_TILES = 8.0, 24
_CLOSE_M, _CLOSE_DETAIL = 8.0, 3.0
_HILLS_SHARE, _HIGHEST_HILL_M = 0.055, 9.0  # of the size
_WOODS_BEYOND_M, _WOODS_M, _GAP_SHARE = 30.0, 20.0, 0.22
_BESIDE_EVERY_M, _BESIDE_M = 1.5, (2.2, 8.0)
_WALL_STEP_M, _WALL_STEPS, _WALL_GAPS, _WALL_ASIDE_M = 1.5, (8, 18), (1, 4), (2.0, 2.7)
_PER_M2 = 1 / 70.0
_HEDGES, _BARNS = 5, 3
_SKY_M = 1500.0


def layout(spec: FieldWorld, seed: int) -> Route:
    """Route of a ring about the origin, for every seed."""
    del seed
    reach = _RING_SHARE * spec.size_m
    corners = reach * np.array([[-1.0, -0.8], [1.0, -0.8], [1.0, 0.8], [-1.0, 0.8]])
    return Route(rounded(corners, 0.45 * reach, True), _CLEARANCE_M, True)


def build_world(spec: FieldWorld, seed: int) -> WorldModel:
    """The field with its textures."""
    rng = rng_for(seed, "world", "field")
    half = np.full(2, spec.size_m / 2 + _WOODS_BEYOND_M)
    line = _fine(layout(spec, seed).centre_m)
    twins = spec.twins
    hills_m = min(_HIGHEST_HILL_M, _HILLS_SHARE * spec.size_m)
    relief = Relief(line, half, hills_m, rng, turned=twins is not None)
    light = Daylight(-half, half, rng, spec)
    light.lay_ground(relief.height)
    farm = _Farm(spec, line, relief, light, rng)
    things = (
        farm.walls()
        + farm.barns()
        + farm.hedges()
        + farm.beside_the_route()
        + farm.scattered()
        + farm.fences()
    )
    tiles = min(_MOST_TILES, int(np.ceil(2 * half[0] / _TILE_M)))
    tiles += tiles % 2 if twins else 0
    sky = Sky(np.zeros(2), _SKY_M, "pasture", spec)
    ground = Tiling(half, tiles, "pasture", _CLOSE_M, _CLOSE_DETAIL).pieces(relief, light)
    woods = _surrounding_woods(half, relief, rng)
    if twins:
        around = [piece for piece in ground + woods if _in_the_south(piece)]
        there = [piece for piece in things if _in_the_south(piece)]
        pieces = with_twins(around, there, np.zeros(2), twins, seed)
    else:
        pieces = ground + things + woods
    return assemble_pieces([*pieces, *sky.pieces(), sky.ridge(rng)], seed, spec.aliased)


def _in_the_south(piece: Piece) -> bool:
    """Return True for one of two pieces that half a turn about the origin exchanges."""
    x, y, _ = piece.vertices.mean(axis=0)
    return bool(y < -1e-6 or (y < 1e-6 and x < 0))


class _Farm:
    """Places objects on the ground, clear of the route and of each other."""

    def __init__(
        self, spec: FieldWorld, line: np.ndarray, relief: Relief, light: Daylight, rng: np.random.Generator
    ) -> None:
        self._size_m = spec.size_m
        self._line, self._relief, self._light, self._rng = line, relief, light, rng
        self._taken = np.empty((0, 3))  # plan position and radius of every object

    def beside_the_route(self) -> list[Piece]:
        """Objects every few metres on either side of the route, for parallax."""
        pieces = []
        for k, (here, left) in enumerate(self._stations(_BESIDE_EVERY_M)):
            for side in (1.0, -1.0):
                aside = side * self._rng.uniform(*_BESIDE_M) * left
                pieces += self._place_object(here + aside, f"beside {k},{side:+.0f}")
        return pieces

    def walls(self) -> list[Piece]:
        """Dry stone walls with openings along the route, on alternating sides."""
        stations = self._stations(_WALL_STEP_M)
        pieces = []
        for side in (1.0, -1.0):
            at = 0
            while at < len(stations) - 3:
                count, gap = (int(self._rng.integers(*span)) for span in (_WALL_STEPS, _WALL_GAPS))
                aside = side * self._rng.uniform(*_WALL_ASIDE_M)
                run = stations[at : at + count]
                spots = [here + aside * left for here, left in run]
                at += len(run) + gap
                if len(spots) > 2:
                    feet = np.array([self._relief.stand(spot) for spot in spots])
                    label = f"wall {side:+.0f},{len(pieces)}"
                    pieces.append(field_wall(feet, label, self._light, self._rng))
                    self._taken = np.vstack([self._taken, *([*spot, 1.0] for spot in spots)])
        return pieces

    def scattered(self) -> list[Piece]:
        """Objects all over the field."""
        spots = self._rng.uniform(-0.5, 0.5, (int(_PER_M2 * self._size_m**2), 2))
        spots *= self._size_m + _WOODS_BEYOND_M
        return [piece for k, spot in enumerate(spots) for piece in self._place_object(spot, f"thing {k}")]

    def hedges(self) -> list[Piece]:
        """Hedges in all directions; they leave the route free."""
        pieces = []
        for k in range(_HEDGES):
            middle = self._rng.uniform(-0.45, 0.45, 2) * self._size_m
            turn, high = self._rng.uniform(0, np.pi), self._rng.uniform(1.1, 1.9)
            reach = self._rng.uniform(0.08, 0.16) * self._size_m
            way = reach * np.array([np.cos(turn), np.sin(turn)])
            plan = np.linspace(middle - way, middle + way, max(3, round(2 * reach / (0.75 * high))))
            free = [spot for spot in plan if self._free(spot, 0.8 * high)]
            if len(free) > 1:
                feet = np.array([self._relief.stand(spot) for spot in free])
                pieces.append(hedge(feet, high, f"hedge {k}", self._rng))
                for foot in feet:
                    self._light.shade_round(foot[:2], 0.6 * high, foot[2] + 0.9 * high)
        return pieces

    def barns(self) -> list[Piece]:
        """Barns of different size, one of them inside the ring."""
        pieces = []
        for k in range(_BARNS):
            size = tuple(self._rng.uniform([8, 5.5, 4.5], [15, 8, 7.5]).tolist())
            for _ in range(40):
                spot = self._rng.uniform(-1, 1, 2) * self._size_m * (0.12 if k == 0 else 0.5)
                if self._free(spot, 0.6 * size[0]):
                    foot = self._relief.stand(spot) - [0, 0, 0.5]
                    turn = self._rng.uniform(0, np.pi)
                    pieces.append(barn(foot, turn, size, f"barn {k}", self._light))
                    break
        return pieces

    def fences(self) -> list[Piece]:
        """A fence around the field that follows the ground."""
        half = self._size_m / 2
        corners = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        pieces = []
        for side, (start, end) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
            edges = np.linspace(start, end, max(2, round(self._size_m / 15)) + 1)
            for k, (a, b) in enumerate(pairwise(edges)):
                feet = [self._relief.stand(spot) for spot in fence_feet(a, b)]
                pieces.append(fence(np.array(feet), f"fence {side},{k}"))
        return pieces

    def _stations(self, every_m: float) -> list[tuple[np.ndarray, np.ndarray]]:
        """Points of the route at even distances, each with the unit vector to its left."""
        arc = arc_length(self._line)
        at = np.arange(0, arc[-1], every_m)
        here, ahead = (
            np.column_stack([np.interp(s % arc[-1], arc, c) for c in self._line.T]) for s in (at, at + 0.5)
        )
        ways = (ahead - here) / np.linalg.norm(ahead - here, axis=1, keepdims=True)
        return list(zip(here, np.column_stack([-ways[:, 1], ways[:, 0]]), strict=True))

    def _place_object(self, spot: np.ndarray, name: str) -> list[Piece]:
        """Place a plant, a stone or a bale if there is room."""
        rng, relief, light = self._rng, self._relief, self._light
        kind = str(rng.choice(["tree", "conifer", "bush", "stone", "bale"], p=[0.24, 0.2, 0.16, 0.28, 0.12]))
        size = float(rng.uniform(*_SIZES_M[kind]))
        if not self._free(spot, _ROOM[kind] * size):
            return []
        foot = relief.stand(spot)
        if kind == "stone":
            return [stone(foot, size, f"stone {name}", light, rng)]
        if kind == "bale":
            return [bale(foot, rng.uniform(0, np.pi), f"bale {name}", light)]
        light.shade_round(spot, _CROWN[kind] * size, foot[2] + 0.85 * size)
        make = {"tree": tree, "conifer": conifer, "bush": bush}[kind]
        return [make(foot - [0, 0, 0.1], size, f"{kind} {name}", rng)]

    def _free(self, spot: np.ndarray, radius_m: float) -> bool:
        """Reserve a place for a round object; return False if it does not fit."""
        if self._relief.away(spot) < _CLEARANCE_M + 0.4 + radius_m:
            return False
        gaps = np.linalg.norm(self._taken[:, :2] - spot, axis=1) - self._taken[:, 2]
        if (gaps < 0.7 * radius_m).any():
            return False
        self._taken = np.vstack([self._taken, [*spot, 0.7 * radius_m]])
        return True


_SIZES_M = {"tree": (4, 11), "conifer": (4, 12), "bush": (0.5, 1.8), "stone": (0.35, 1.4), "bale": (1.3, 1.3)}
_ROOM = {"tree": 0.36, "conifer": 0.2, "bush": 0.6, "stone": 0.55, "bale": 0.7}  # radius per size
_CROWN = {"tree": 0.4, "conifer": 0.18, "bush": 0.6}


def _fine(line: np.ndarray) -> np.ndarray:
    """A polyline with points at most half a metre apart."""
    parts = [
        np.linspace(a, b, max(2, int(2 * np.linalg.norm(b - a)) + 1), endpoint=False)
        for a, b in pairwise(line)
    ]
    return np.concatenate([*parts, line[-1:]])


def _surrounding_woods(half: np.ndarray, relief: Relief, rng: np.random.Generator) -> list[Piece]:
    """Surrounding woods, with gaps that show the distant hills."""
    corners = half * [[-1, -1], [-1, 1], [1, 1], [1, -1]]
    pieces = []
    for side, (start, end) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        edges = np.linspace(start, end, max(2, round(2 * half[0] / _WOODS_M)) + 1)
        grown = np.concatenate([[True], rng.random(len(edges) - 1) > _GAP_SHARE, [True]])
        for k, ends in enumerate(pairwise(edges)):
            if grown[k + 1]:
                high = rng.uniform(4, 10) + float(relief.height(np.array(ends)).max())
                closed = (bool(grown[k]), bool(grown[k + 2]))
                pieces.append(ragged_woods(np.array(ends), high, f"woods {side},{k}", rng, closed))
    return pieces
