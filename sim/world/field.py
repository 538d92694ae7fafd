"""Open grassland: tussocky ground, bushes, single trees, a fence, and woods around under a wide sky."""

from itertools import pairwise

import numpy as np

from scenarios.seeds import rng_for
from scenarios.worlds import FieldWorld
from sim.world.assembly import assemble
from sim.world.base import Route, WorldModel
from sim.world.meshes import Piece
from sim.world.outdoor import Daylight, Sky, ground_piece
from sim.world.plants import bush, ragged_woods, tree
from sim.world.route import rounded
from sim.world.street_furniture import bollards

_CLEARANCE_M = 1.5
_TILE_M = 8.0
_RING_SHARE = 0.33  # of the size, from the middle to the route
_PER_M2 = 1 / 55.0
_KEEP_OFF_M = 3.0  # of the route
_WOODS_BEYOND_M, _WOODS_M = 30.0, 20.0


def layout(spec: FieldWorld, seed: int) -> Route:
    """A ring about the origin; the same for every seed."""
    del seed
    reach = _RING_SHARE * spec.size_m
    corners = reach * np.array([[-1.0, -0.8], [1.0, -0.8], [1.0, 0.8], [-1.0, 0.8]])
    return Route(rounded(corners, 0.45 * reach, True), _CLEARANCE_M, True)


def build_world(spec: FieldWorld, seed: int) -> WorldModel:
    """The field with its textures."""
    rng = rng_for(seed, "world", "field")
    half = np.full(2, spec.size_m / 2 + _WOODS_BEYOND_M)
    light = Daylight(-half, half, rng)
    things = _plants(spec, light, rng) + _fence(spec)
    pieces = _ground(half, light) + things + _surrounding_woods(half, rng)
    pieces += Sky(np.zeros(2), 1500.0, "meadow").pieces()
    return assemble(pieces, seed)


def _ground(half: np.ndarray, light: Daylight) -> list[Piece]:
    count = int(np.ceil(2 * half[0] / _TILE_M))
    size = 2 * half[0] / count
    right = np.array([1.0, 0.0])
    return [
        ground_piece(
            -half + size * np.array([i, j + 1]), right, (size, size), "meadow", f"ground {i},{j}", light
        )
        for i in range(count)
        for j in range(count)
    ]


def _plants(spec: FieldWorld, light: Daylight, rng: np.random.Generator) -> list[Piece]:
    """Bushes and trees at random, off the route."""
    line = layout(spec, 0).centre_m
    fine = np.concatenate([np.linspace(a, b, 20) for a, b in pairwise(line)])
    pieces = []
    for k in range(int(_PER_M2 * spec.size_m**2)):
        spot = rng.uniform(-0.5, 0.5, 2) * (spec.size_m + _WOODS_BEYOND_M)
        wooded = rng.random() < 0.3
        if np.linalg.norm(fine - spot, axis=1).min() < _KEEP_OFF_M:
            continue
        high = rng.uniform(4, 9) if wooded else rng.uniform(0.5, 1.8)
        make = tree if wooded else bush
        pieces.append(make(np.append(spot, 0.0), high, f"plant {k}", rng))
        turn = 2 * np.pi * np.arange(8) / 8
        reach = (0.4 if wooded else 0.6) * high
        light.shade_polygon(spot + reach * np.column_stack([np.cos(turn), np.sin(turn)]), 0.85 * high)
    return pieces


def _fence(spec: FieldWorld) -> list[Piece]:
    """Posts along the square's edges."""
    half = spec.size_m / 2
    corners = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    pieces = []
    for side, (start, end) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        edges = np.linspace(start, end, max(2, round(spec.size_m / 15)) + 1)
        for k, (a, b) in enumerate(pairwise(edges)):
            pieces.append(bollards(np.append(a, 0.0), np.append(b, 0.0), 2.2, f"fence {side},{k}"))
    return pieces


def _surrounding_woods(half: np.ndarray, rng: np.random.Generator) -> list[Piece]:
    corners = half * [[-1, -1], [-1, 1], [1, 1], [1, -1]]
    pieces = []
    for side, (start, end) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        edges = np.linspace(start, end, max(2, round(2 * half[0] / _WOODS_M)) + 1)
        for k, ends in enumerate(pairwise(edges)):
            pieces.append(ragged_woods(np.array(ends), rng.uniform(9, 14), f"woods {side},{k}", rng))
    return pieces
