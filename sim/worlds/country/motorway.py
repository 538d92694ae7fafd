"""A motorway: lanes, guard rails, few signs, bridges, verges, woods and hills."""

from dataclasses import replace

import numpy as np

from dslab.scenarios.seeds import rng_for
from dslab.scenarios.worlds import MotorwayWorld
from dslab.sim.worlds.assembly import assemble_pieces
from dslab.sim.worlds.base import Route, WorldModel
from dslab.sim.worlds.country.roadworks import bridge, gantry, guard_rail, noise_wall
from dslab.sim.worlds.geometry.meshes import Mesh, Piece
from dslab.sim.worlds.geometry.outdoor import Daylight, Sky
from dslab.sim.worlds.geometry.plants import bush, conifer, ragged_woods, tree
from dslab.sim.worlds.geometry.street_furniture import sign_post
from dslab.sim.worlds.geometry.twins import with_twins

_STEP_M = 20.0
_BEHIND_M, _BEYOND_M = 60.0, 500.0
_ROAD_M = (1.0, -12.0)  # left and right edge, from the left border of the carriageway
_OTHER_M = (16.0, 3.0)
_LANE_M = -8.0
_CLEARANCE_M = 1.0
_VERGES_M = ((58.0, 16.0), (3.0, 1.0), (-12.0, -56.0))
_RAILS_M = (2.0, -12.9)
_WOODS_M, _WOODS_SWAY_M, _GAP_SHARE = (52.0, -48.0), 6.0, 0.15
_GANTRY_M, _PIERS_M = (1.6, -13.4), (-14.6, 2.0, 18.5)
_WALL_M = -14.4
_LIGHT_M = 1.0
_SKY_BEYOND_M = 1500.0

Section = tuple[np.ndarray, np.ndarray]
"""(2, 2) reference points at both ends of a section of road, and (2, 2) unit vectors to the left there."""


def layout(spec: MotorwayWorld, seed: int) -> Route:
    """The right-hand lane from the origin."""
    line, left = _line(spec, seed)
    lane = line + _LANE_M * left
    if spec.loop:
        return Route(lane - lane[0], _CLEARANCE_M, True)
    inside = [k for k, s in enumerate(_stations(spec)) if -1e-6 <= s <= spec.length_m + _STEP_M / 2]
    lane = lane[inside[0] : inside[-1] + 1]
    return Route(lane - lane[0], _CLEARANCE_M, False)


def build_world(spec: MotorwayWorld, seed: int) -> WorldModel:
    """The motorway with its textures."""
    rng = rng_for(seed, "world", "motorway")
    line, left = _line(spec, seed)
    start = 0 if spec.loop else int(np.argmin(np.abs(_stations(spec))))
    line = line - (line + _LANE_M * left)[start]
    twins = spec.twins if spec.loop else None
    light = Daylight(line.min(axis=0) - 70, line.max(axis=0) + 70, rng, spec)
    sections = [(line[k : k + 2], left[k : k + 2]) for k in range(len(line) - 1)]
    # Of a ring whose halves are twins, only the first is built.
    sections = sections[: len(sections) // 2] if twins else sections
    beside = [
        _built(section, k, light, rng) + _grown(section, k, light, rng) for k, section in enumerate(sections)
    ]
    walled = _walled(len(sections), rng)
    pieces: list[Piece] = []
    for k, section in enumerate(sections):
        pieces.append(_ribbon(section, _ROAD_M, "motorway", f"lanes {k}", light))
        pieces.append(_ribbon(section, _OTHER_M[::-1], "motorway", f"other lanes {k}", light))
        for j, edges in enumerate(_VERGES_M):
            pieces.append(_ribbon(section, edges, "verge", f"verge {k},{j}", light))
        for at in _RAILS_M:
            pieces.append(
                guard_rail(_along(section, at), f"rail {k},{at:+.0f}", _upright(section, at, light))
            )
        if walled[k]:
            pieces.append(
                noise_wall(_along(section, _WALL_M), f"wall {k}", _upright(section, _WALL_M, light))
            )
        pieces += [] if twins else beside[k]
    woods = _woods(line[: len(sections) + 1], left[: len(sections) + 1], rng, spec.loop)
    if twins:
        things = [piece for some in beside for piece in some]
        pieces = with_twins(pieces + woods, things, line[:-1].mean(axis=0), twins, seed)
    else:
        pieces += woods
    middle, reach = line.mean(axis=0), float(np.linalg.norm(np.ptp(line, axis=0)))
    sky = Sky(middle, reach + _SKY_BEYOND_M, "verge", spec)
    # Rails, posts and far markings are thinner than a pixel and would flicker with one sample.
    everything = [*pieces, *sky.pieces(), sky.ridge(rng)]
    return replace(assemble_pieces(everything, seed, spec.aliased), samples=4)


def _stations(spec: MotorwayWorld) -> np.ndarray:
    return np.arange(-_BEHIND_M, spec.length_m + _BEYOND_M, _STEP_M)


def _line(spec: MotorwayWorld, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(M, 2) reference line, straight at first, then in gentle bends, and (M, 2) its unit vectors left.

    That of a ring is a circle, whose first point is repeated at its end.
    """
    if spec.loop:
        turn = np.linspace(0, 2 * np.pi, 2 * round(spec.length_m / _STEP_M / 2) + 1)
        # The lane has the length asked for.
        radius = spec.length_m / (2 * np.pi) + _LANE_M
        left = np.column_stack([-np.sin(turn), np.cos(turn)])
        return radius * -left, left
    rng = rng_for(seed, "world", "motorway", "plan")
    stations = _stations(spec)
    swing = rng.uniform(0.08, 0.16) * rng.choice([-1, 1])
    heading = swing * (1 - np.cos(2 * np.pi * np.maximum(stations, 0.0) / rng.uniform(500, 800)))
    ways = np.column_stack([np.cos(heading), np.sin(heading)])
    line = np.vstack([np.zeros(2), np.cumsum(_STEP_M * (ways[1:] + ways[:-1]) / 2, axis=0)])
    return line, np.column_stack([-ways[:, 1], ways[:, 0]])


def _along(section: Section, at_m: float) -> np.ndarray:
    """(2, 2) ends of a line beside the road."""
    return section[0] + at_m * section[1]


def _ribbon(section: Section, edges: tuple[float, float], finish: str, label: str, light: Daylight) -> Piece:
    """Ground between two cross sections; ``edges[0]`` is the upper edge of the sheet."""
    high = abs(edges[0] - edges[1])
    upper, lower = _along(section, edges[0]), _along(section, edges[1])
    corners = np.array([upper[0], upper[1], lower[1], lower[0]])
    if edges[0] < edges[1]:
        corners = corners[[1, 0, 3, 2]]
    # Slightly longer, so that no crack opens between neighbours.
    corners = corners + 2e-3 * np.sign(corners - corners.mean(axis=0))
    mesh = Mesh()
    mesh.quad(np.column_stack([corners, np.zeros(4)]), (0.0, 0.0), (_STEP_M, high))
    columns, rows = round(_STEP_M / _LIGHT_M), max(2, round(high / _LIGHT_M))
    u, v = (np.arange(columns) + 0.5) / columns, ((np.arange(rows) + 0.5) / rows)[:, None, None]
    top = corners[0] + u[:, None] * (corners[1] - corners[0])
    bottom = corners[3] + u[:, None] * (corners[2] - corners[3])
    plan = (1 - v) * top + v * bottom
    points = np.concatenate([plan, np.zeros((rows, columns, 1))], axis=-1)
    return Piece.of(mesh, (_STEP_M, high), finish, label, light.gain(points, np.array([0.0, 0.0, 1.0])))


def _upright(section: Section, at_m: float, light: Daylight) -> np.ndarray:
    """(2, columns) light on the road side of a low upright object beside the road."""
    ends, left = _along(section, at_m), section[1].mean(axis=0)
    share = (np.arange(round(_STEP_M / _LIGHT_M)) + 0.5) / round(_STEP_M / _LIGHT_M)
    plan = ends[0] + share[:, None] * (ends[1] - ends[0])
    points = np.column_stack([plan, np.full(len(plan), 0.8)])
    facing = np.append(-left if at_m > _LANE_M else left, 0.0)
    return np.repeat(light.gain(points, facing)[None], 2, axis=0)


def _walled(count: int, rng: np.random.Generator) -> np.ndarray:
    """(count,) bool: sections with a noise wall, in one or two short rows."""
    walled = np.zeros(count, bool)
    for _ in range(max(1, count // 45)):
        first = int(rng.integers(3, max(4, count - 12)))
        walled[first : first + int(rng.integers(5, 10))] = True
    return walled


def _built(section: Section, k: int, light: Daylight, rng: np.random.Generator) -> list[Piece]:
    """Signs, gantries and bridges."""
    a, left = section[0][0], section[1][0]
    facing = np.array([-left[1], left[0]])
    pieces = []
    if k % 3 == 0:
        spot = np.append(a - 12.6 * left, 0.0)
        pieces.append(sign_post(spot, facing, (0.15, 0.3), f"post {k}"))
    if k % 17 == 9:
        spot = np.append(a - 15.0 * left, 0.0)
        pieces.append(sign_post(spot, facing, (3.2, 2.4), f"sign {k}"))
    if k % 17 == 14:
        pieces += gantry(a + _GANTRY_M[0] * left, a + _GANTRY_M[1] * left, facing, f"gantry {k}", rng)
    if k % 26 == 20:
        piers = [a + aside * left for aside in _PIERS_M]
        pieces += bridge(a - 54 * left, a + 56 * left, piers, f"bridge {k}", light)
    return pieces


def _grown(section: Section, k: int, light: Daylight, rng: np.random.Generator) -> list[Piece]:
    """Bushes and trees on the verges, some in groups."""
    a, left = section[0][0], section[1][0]
    ahead = (section[0][1] - a) / _STEP_M
    pieces = []
    for j, reach in enumerate(((-44.0, -17.0), (20.0, 48.0))):
        for n in range(int(rng.choice([0, 1, 2, 4], p=[0.35, 0.35, 0.2, 0.1]))):
            plan = a + rng.uniform(*reach) * left + rng.uniform(0, _STEP_M) * ahead
            spot, name = np.append(plan, -0.05), f"{k},{j},{n}"
            kind = rng.random()
            if kind < 0.5:
                pieces.append(bush(spot, rng.uniform(0.8, 2.0), f"bush {name}", rng))
                continue
            high = rng.uniform(4, 9)
            make, reach_m = (tree, 0.4) if kind < 0.82 else (conifer, 0.18)
            pieces.append(make(spot, high, f"tree {name}", rng))
            light.shade_round(plan, reach_m * high, 0.85 * high)
    return pieces


def _woods(line: np.ndarray, left: np.ndarray, rng: np.random.Generator, ring: bool) -> list[Piece]:
    """Woods with gaps along both sides, at varying distance, and across both ends of a road that has ends."""
    pieces = []
    for side, at in enumerate(_WOODS_M):
        edge = line + (at + rng.uniform(-_WOODS_SWAY_M, _WOODS_SWAY_M, (len(line), 1))) * left
        edge = edge if at > 0 else edge[::-1]
        grown = np.concatenate([[True], rng.random(len(line) - 1) > _GAP_SHARE, [True]])
        for k in np.flatnonzero(grown[1:-1]).tolist():
            closed = (bool(grown[k]), bool(grown[k + 2]))
            label = f"woods {side},{k}"
            pieces.append(ragged_woods(edge[k : k + 2], rng.uniform(9, 15), label, rng, closed))
    for end, towards, name in () if ring else ((0, 1.0, "start"), (-1, -1.0, "end")):
        edge = np.array([line[end] + towards * 60.0 * left[end], line[end] - towards * 60.0 * left[end]])
        for k in range(4):
            part = edge[0] + np.array([[k / 4], [(k + 1) / 4]]) * (edge[1] - edge[0])
            pieces.append(ragged_woods(part, rng.uniform(10, 15), f"woods {name} {k}", rng))
    return pieces
