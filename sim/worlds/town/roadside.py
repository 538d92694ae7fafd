"""Objects along a street: parked cars, trees, lamps, signs and bollards."""

import numpy as np

from dslab.sim.worlds.geometry.car_shapes import SHAPES
from dslab.sim.worlds.geometry.meshes import Piece
from dslab.sim.worlds.geometry.outdoor import Daylight
from dslab.sim.worlds.geometry.plants import tree
from dslab.sim.worlds.geometry.street_furniture import bollards, lamp_post, sign_post
from dslab.sim.worlds.town.pavements import KERB_M
from dslab.sim.worlds.town.streets import CARRIAGEWAY_M, Plan, Street

_PARKED_M = CARRIAGEWAY_M - 1.08  # middle of a parked car, from the middle of the street
_KEEP_CLEAR_M = 13.0  # of a crossing's middle
_PARKED_SHARE, _SLOT_M = 0.72, 5.7
_TREE_SPACING_M, _LAMP_SPACING_M = (9.0, 17.0), 26.0
_KINDS = tuple(SHAPES)


def roadside(plan: Plan, street: Street, light: Daylight, rng: np.random.Generator) -> list[Piece]:
    """Everything along a street; each object casts its shadow on ``light``."""
    rank = plan.streets.index(street)
    pieces: list[Piece] = []
    clear = plan.crossings(street)
    for side in (1.0, -1.0):
        spans = [(a, b) for a, b in plan.free(street, side * _PARKED_M, _KEEP_CLEAR_M) if b - a > _SLOT_M]
        for span in spans:
            pieces += _cars(street, side, span, f"car {rank},{side:+.0f}", light, rng)
        name = f"{rank},{side:+.0f}"
        pieces += _trees(street, side, clear, f"tree {name}", light, rng)
        pieces += _posts(street, side, clear, name, light, rng)
    return pieces


def _cars(
    street: Street,
    side: float,
    span: tuple[float, float],
    label: str,
    light: Daylight,
    rng: np.random.Generator,
) -> list[Piece]:
    """Cars parked at the kerb with gaps, some askew, most facing with the traffic."""
    cars, at = [], span[0] + rng.uniform(0, 2)
    while True:
        finish = _KINDS[rng.choice(len(_KINDS), p=(0.32, 0.36, 0.22, 0.1))]
        shape = SHAPES[finish]
        if at + shape.length_m > span[1] - 0.3:
            return cars
        if rng.random() < _PARKED_SHARE:
            ahead = -side if rng.random() < 0.9 else side
            turn = np.deg2rad(rng.normal(0, 0.9))
            way = ahead * (np.cos(turn) * street.way + np.sin(turn) * street.left)
            middle = street.point(at + shape.length_m / 2, side * (_PARKED_M + rng.normal(0, 0.05)))
            # The position along the street names the car.
            cars.append(_car(finish, middle, way, f"{label},{at:.1f}", light))
        at += shape.length_m + rng.uniform(0.6, 1.8)


def _car(finish: str, middle: np.ndarray, way: np.ndarray, label: str, light: Daylight) -> Piece:
    shape = SHAPES[finish]
    left = np.array([-way[1], way[0]])
    local = np.concatenate(shape.mesh.vertices)
    plan = middle + (local[:, :1] - shape.length_m / 2) * way + local[:, 1:2] * left
    half = shape.length_m / 2
    corners = [middle + x * half * way + y * 0.8 * left for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    light.shade_polygon(np.array(corners), 1.0)
    inner = [middle + x * 0.5 * half * way + y * 0.7 * left for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    light.shade_polygon(np.array(inner), 1.4)
    uv = np.concatenate(shape.mesh.sheet_m) / shape.sheet_m
    vertices = np.column_stack([plan, local[:, 2]])
    return Piece(vertices, np.concatenate(shape.mesh.triangles), uv, shape.sheet_m, finish, label)


def _trees(
    street: Street, side: float, clear: list[float], label: str, light: Daylight, rng: np.random.Generator
) -> list[Piece]:
    """Trees near the kerb; some streets have none on a side."""
    if rng.random() < 0.2:
        return []
    trees, at = [], rng.uniform(4, 12)
    while at < street.length_m - 4:
        if all(abs(at - c) > 11 for c in clear):
            spot = np.append(street.point(at, side * (CARRIAGEWAY_M + 0.8)), KERB_M)
            height = rng.uniform(4.5, 8.5)
            trees.append(tree(spot, height, f"{label},{at:.1f}", rng))
            turn = 2 * np.pi * np.arange(9) / 9
            reach = 0.42 * height * rng.uniform(0.7, 1.1, 9)
            crown = spot[:2] + reach[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
            light.shade_polygon(crown, 0.9 * height)
        at += rng.uniform(*_TREE_SPACING_M)
    return trees


def _posts(
    street: Street, side: float, clear: list[float], name: str, light: Daylight, rng: np.random.Generator
) -> list[Piece]:
    """Lamps at even intervals, signs at crossings, sometimes a row of bollards."""
    pieces = []
    towards = -side * street.left
    offset = 0.0 if side > 0 else _LAMP_SPACING_M / 2
    for at in np.arange(6.0 + offset, street.length_m - 2, _LAMP_SPACING_M).tolist():
        if all(abs(at - c) > 9 for c in clear):
            spot = np.append(street.point(at, side * (CARRIAGEWAY_M + 0.45)), KERB_M)
            pieces.append(lamp_post(spot, towards, f"lamp {name},{at:.1f}"))
            square = spot[:2] + 0.15 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
            light.shade_polygon(square, 6.0)
    for at in clear:
        place = at + side * 10.5
        if 1 < place < street.length_m - 1 and rng.random() < 0.7:
            spot = np.append(street.point(place, side * (CARRIAGEWAY_M + 0.5)), KERB_M)
            size = (rng.uniform(0.5, 0.9), rng.uniform(0.45, 0.75))
            pieces.append(sign_post(spot, side * street.way, size, f"sign {name},{at:.1f}"))
        row = at - side * 10.0
        if 7 < row < street.length_m - 7 and rng.random() < 0.4:
            ends = [
                np.append(street.point(row - k, side * (CARRIAGEWAY_M + 0.4)), KERB_M) for k in (0.0, 5.0)
            ]
            pieces.append(bollards(ends[0], ends[1], 1.3, f"bollards {name},{at:.1f}"))
    return pieces
