"""A motorway: lanes, guard rails, posts, few signs and bushes, woods far to both sides, a wide sky."""

import numpy as np

from scenarios.seeds import rng_for
from scenarios.worlds import MotorwayWorld
from sim.world.assembly import assemble
from sim.world.base import Route, WorldModel
from sim.world.meshes import Mesh, Piece, rise
from sim.world.outdoor import Sky
from sim.world.plants import bush, ragged_woods, tree
from sim.world.street_furniture import sign_post

_STEP_M = 20.0
_BEHIND_M, _BEYOND_M = 60.0, 500.0
_ROAD_M = (1.0, -12.0)  # left and right edge, from the left border of the carriageway
_OTHER_M = (16.0, 3.0)
_LANE_M = -8.0
_CLEARANCE_M = 1.0
_VERGES_M = ((54.0, 16.0), (3.0, 1.0), (-12.0, -50.0))
_RAILS_M = (2.0, -12.9)
_WOODS_M = (52.0, -48.0)


def layout(spec: MotorwayWorld, seed: int) -> Route:
    """The right-hand lane from the origin."""
    inside = [k for k, s in enumerate(_stations(spec)) if -1e-6 <= s <= spec.length_m + _STEP_M / 2]
    line, left = _line(spec, seed)
    lane = (line + _LANE_M * left)[inside[0] : inside[-1] + 1]
    return Route(lane - lane[0], _CLEARANCE_M, False)


def build_world(spec: MotorwayWorld, seed: int) -> WorldModel:
    """The motorway with its textures."""
    rng = rng_for(seed, "world", "motorway")
    line, left = _line(spec, seed)
    start = int(np.argmin(np.abs(_stations(spec))))
    line = line - (line + _LANE_M * left)[start]
    pieces: list[Piece] = []
    for k in range(len(line) - 1):
        section = (line[k : k + 2], left[k : k + 2])
        pieces.append(_ribbon(section, _ROAD_M, 0.0, "motorway", f"lanes {k}"))
        pieces.append(_ribbon(section, _OTHER_M[::-1], 0.0, "motorway", f"other lanes {k}"))
        for j, edges in enumerate(_VERGES_M):
            pieces.append(_ribbon(section, edges, 0.0, "verge", f"verge {k},{j}"))
        pieces += [_rail(section, at, f"rail {k},{at:+.0f}") for at in _RAILS_M]
        pieces += [_woods(section, at, rng.uniform(9, 15), f"woods {k},{at:+.0f}", rng) for at in _WOODS_M]
        pieces += _sparse(section, k, rng)
    for end, name in ((0, "start"), (-1, "end")):
        pieces.append(_closing_woods(line[end], left[end], 1.0 if end == 0 else -1.0, f"woods {name}", rng))
    middle, reach = line.mean(axis=0), float(np.linalg.norm(np.ptp(line, axis=0)))
    pieces += Sky(middle, reach + 1500.0, "verge").pieces()
    return assemble(pieces, seed)


def _stations(spec: MotorwayWorld) -> np.ndarray:
    return np.arange(-_BEHIND_M, spec.length_m + _BEYOND_M, _STEP_M)


def _line(spec: MotorwayWorld, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(M, 2) reference line, straight at first, then in gentle bends, and (M, 2) its unit vectors left."""
    rng = rng_for(seed, "world", "motorway", "plan")
    stations = _stations(spec)
    swing = rng.uniform(0.08, 0.16) * rng.choice([-1, 1])
    heading = swing * (1 - np.cos(2 * np.pi * np.maximum(stations, 0.0) / rng.uniform(500, 800)))
    ways = np.column_stack([np.cos(heading), np.sin(heading)])
    line = np.vstack([np.zeros(2), np.cumsum(_STEP_M * (ways[1:] + ways[:-1]) / 2, axis=0)])
    return line, np.column_stack([-ways[:, 1], ways[:, 0]])


def _ribbon(
    section: tuple[np.ndarray, np.ndarray], edges: tuple[float, float], z_m: float, finish: str, label: str
) -> Piece:
    """Ground between two cross sections; of ``edges`` the first is the upper edge of the sheet."""
    (a, b), (left_a, left_b) = section
    high = abs(edges[0] - edges[1])
    flat = [a + edges[0] * left_a, b + edges[0] * left_b, b + edges[1] * left_b, a + edges[1] * left_a]
    corners = np.array(flat) if edges[0] > edges[1] else np.array([flat[1], flat[0], flat[3], flat[2]])
    # A hair longer, so that no crack opens between neighbours.
    corners = corners + 2e-3 * np.sign(corners - corners.mean(axis=0))
    mesh = Mesh()
    mesh.quad(np.column_stack([corners, np.full(4, z_m)]), (0.0, 0.0), (_STEP_M, high))
    return Piece.of(mesh, (_STEP_M, high), finish, label)


def _rail(section: tuple[np.ndarray, np.ndarray], at_m: float, label: str) -> Piece:
    """A guard rail seen from the road, both faces, on posts."""
    (a, b), (left_a, left_b) = section
    ends = np.array([a + at_m * left_a, b + at_m * left_b])
    mesh = Mesh()
    top, bottom = (np.column_stack([ends, np.full(2, z)]) for z in (0.75, 0.45))
    mesh.quad(np.array([top[0], top[1], bottom[1], bottom[0]]), (0.0, 0.0), (_STEP_M, 0.3))
    mesh.quad(np.array([top[1], top[0], bottom[0], bottom[1]]), (0.0, 0.0), (_STEP_M, 0.3))
    for share in np.arange(0.0, 1.0, 0.2):
        foot = np.append(ends[0] + share * (ends[1] - ends[0]), 0.0)
        mesh.tube(np.array([foot, foot + rise(0.7)]), (0.05, 0.05), 5, (share * _STEP_M, 0.3), (1.0, 0.3))
    return Piece.of(mesh, (_STEP_M, 0.6), "rail", label)


def _woods(
    section: tuple[np.ndarray, np.ndarray], at_m: float, high: float, label: str, rng: np.random.Generator
) -> Piece:
    """The edge of a wood with a ragged top, facing the road."""
    (a, b), (left_a, left_b) = section
    ends = np.array([a + at_m * left_a, b + at_m * left_b])
    return ragged_woods(ends if at_m > 0 else ends[::-1], high, label, rng)


def _closing_woods(
    middle: np.ndarray, left: np.ndarray, towards: float, label: str, rng: np.random.Generator
) -> Piece:
    """Woods across the end of the road, seen from along it."""
    ends = np.array([middle - towards * 60.0 * left, middle + towards * 60.0 * left])
    return ragged_woods(ends[::-1], 14.0, label, rng)


def _sparse(section: tuple[np.ndarray, np.ndarray], k: int, rng: np.random.Generator) -> list[Piece]:
    """The few things beside the road."""
    a, left = section[0][0], section[1][0]
    facing = np.array([-left[1], left[0]])
    pieces = []
    if k % 3 == 0:
        spot = np.append(a - 12.6 * left, 0.0)
        pieces.append(sign_post(spot, facing, (0.15, 0.3), f"post {k}"))
    if k % 17 == 9:
        spot = np.append(a - 14.5 * left, 0.0)
        pieces.append(sign_post(spot, facing, (3.2, 2.4), f"sign {k}"))
    for aside in (rng.uniform(-30, -16), rng.uniform(19, 34)):
        kind = rng.random()
        spot = np.append(a + aside * left, -0.05)
        if kind < 0.25:
            pieces.append(bush(spot, rng.uniform(0.8, 1.8), f"bush {k},{aside:+.1f}", rng))
        elif kind < 0.37:
            pieces.append(tree(spot, rng.uniform(5, 9), f"tree {k},{aside:+.1f}", rng))
    return pieces
