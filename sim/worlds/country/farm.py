"""Objects on farmland: stones, straw bales, fences, walls and barns."""

from itertools import pairwise

import numpy as np

from dslab.sim.worlds.geometry.meshes import Mesh, Piece, bumpy_ball, grid_triangles, rise
from dslab.sim.worlds.geometry.outdoor import Daylight
from dslab.sim.worlds.geometry.route import arc_length

_STONE_RINGS, _STONE_SIDES = 7, 10
_BALE_SIDES, _BALE_M = 20, (1.25, 0.65)  # width and radius
_POST_M, _RAILS_M = 2.5, (0.45, 0.95)
_EAVES_SHARE = 0.55
_WALL_M = (0.5, 1.15)  # thickness and height of a dry stone wall
_WALL_LIGHT_ROWS = 12


def stone(spot: np.ndarray, size_m: float, label: str, light: Daylight, rng: np.random.Generator) -> Piece:
    """A boulder ``size_m`` wide, half sunk into the ground at ``spot`` (3,); ``light`` takes its shadow."""
    ball, bumps = bumpy_ball(_STONE_RINGS, _STONE_SIDES, (0.75, 1.1), rng)
    shape = size_m / 2 * rng.uniform([0.8, 0.8, 0.6], [1.1, 1.1, 0.95])
    points = spot + bumps * ball * shape
    sheet_m = (np.pi * size_m, np.pi * size_m / 2)
    u, v = np.meshgrid(np.linspace(0, sheet_m[0], _STONE_SIDES + 1), np.linspace(0, sheet_m[1], _STONE_RINGS))
    mesh = Mesh()
    mesh.add(
        points.reshape(-1, 3),
        grid_triangles(_STONE_RINGS, _STONE_SIDES + 1),
        np.column_stack([u.ravel(), v.ravel()]),
    )
    gain = light.gain(points, ball)
    light.shade_round(spot[:2], 0.45 * size_m, spot[2] + 0.35 * size_m)
    return Piece.of(mesh, sheet_m, "rock", label, gain)


def bale(spot: np.ndarray, turn_rad: float, label: str, light: Daylight) -> Piece:
    """A round straw bale on its side at ``spot`` (3,) on the ground; ``light`` takes its shadow."""
    wide, radius = _BALE_M
    axis = np.array([np.cos(turn_rad), np.sin(turn_rad), 0.0])
    across = np.array([-axis[1], axis[0], 0.0])
    centre = spot + rise(0.95 * radius)
    round_rad = np.linspace(0, 2 * np.pi, _BALE_SIDES + 1)
    rim = np.cos(round_rad)[:, None] * across + np.sin(round_rad)[:, None] * rise(1.0)
    length, sheet_m = 2 * np.pi * radius, (2 * np.pi * radius, wide + 2 * radius)
    mesh = Mesh()
    coat = np.stack([centre + wide / 2 * axis + radius * rim, centre - wide / 2 * axis + radius * rim])
    u = np.linspace(0, length, _BALE_SIDES + 1)
    sheet = np.concatenate([np.column_stack([u, 0 * u]), np.column_stack([u, 0 * u + wide])])
    mesh.add(coat.reshape(-1, 3), grid_triangles(2, _BALE_SIDES + 1), sheet)
    fan = np.array([[0, k + 1, k + 2] for k in range(_BALE_SIDES)])
    for side, middle in ((1.0, radius), (-1.0, 3 * radius)):
        disc = np.column_stack([np.cos(round_rad), -np.sin(round_rad)]) * radius + [middle, wide + radius]
        end = centre + side * wide / 2 * axis
        vertices = np.vstack([end, end + radius * rim])
        mesh.add(vertices, fan if side > 0 else fan[:, ::-1], np.vstack([[middle, wide + radius], disc]))
    gain = _bale_light(light, centre, rim, axis)
    corners = [spot + x * wide / 2 * axis + y * 0.9 * radius * across for x, y in _SQUARE]
    light.shade_polygon(np.array(corners)[:, :2], spot[2] + 1.7 * radius)
    return Piece.of(mesh, sheet_m, "straw", label, gain)


_SQUARE = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def _bale_light(light: Daylight, centre: np.ndarray, rim: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """(rows, columns) light on a bale's sheet: its coat above, its two ends below."""
    wide, radius = _BALE_M
    rows = 12
    coat_rows = round(rows * wide / (wide + 2 * radius))
    coat = light.gain(centre + radius * rim, rim)
    gain = np.repeat(coat[None], rows, axis=0)
    ends = [float(light.gain(centre + side * wide * axis, side * axis)) for side in (1.0, -1.0)]
    gain[coat_rows:, : gain.shape[1] * 2 // 6] = ends[0]
    gain[coat_rows:, gain.shape[1] * 2 // 6 :] = ends[1]
    return gain


def fence(feet: np.ndarray, label: str) -> Piece:
    """Posts with two rails along feet (n, 3) on the ground."""
    mesh = Mesh()
    for k, foot in enumerate(feet):
        low = (0.0, 0.3 + 0.07 * (k % 10))
        mesh.tube(np.array([foot - rise(0.1), foot + rise(1.15)]), (0.07, 0.06), 6, low, (1.0, 0.5))
    for k, (a, b) in enumerate(pairwise(feet)):
        for j, high in enumerate(_RAILS_M):
            low = (0.2 * ((k + 3 * j) % 5), 0.1 * ((k + 5 * j) % 9))
            _rail(mesh, a + rise(high), b + rise(high), low)
    return Piece.of(mesh, (3.5, 1.5), "timber", label)


def _rail(mesh: Mesh, start: np.ndarray, end: np.ndarray, low_m: tuple[float, float]) -> None:
    """A board seen from both sides."""
    length, up = float(np.linalg.norm(end - start)), rise(0.14)
    for a, b in ((start, end), (end, start)):
        mesh.quad(np.array([a + up, b + up, b, a]), low_m, (min(2.6, length), 0.14))


def fence_feet(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(n, 2) plan positions of the posts of a fence between two plan points."""
    count = max(2, round(float(np.linalg.norm(end - start)) / _POST_M) + 1)
    return np.linspace(start, end, count)


def field_wall(feet: np.ndarray, label: str, light: Daylight, rng: np.random.Generator) -> Piece:
    """A dry stone wall of uneven height along feet (n, 3) on the ground; ``light`` takes its shadow."""
    arc = arc_length(feet)
    way = np.gradient(feet[:, :2], axis=0)
    left = np.column_stack([-way[:, 1], way[:, 0]]) / np.linalg.norm(way, axis=1, keepdims=True)
    aside = np.column_stack([_WALL_M[0] / 2 * left, np.zeros(len(feet))])
    top = feet + np.column_stack([np.zeros((len(feet), 2)), _WALL_M[1] * rng.uniform(0.8, 1.1, len(feet))])
    foot = feet - rise(0.2)
    length, high = float(arc[-1]), 1.1 * _WALL_M[1] + 0.2
    sheet_m = (length, 2 * high + _WALL_M[0])
    mesh = Mesh()
    # Right face, top and left face, one below the other on the sheet.
    lines = (foot - aside, top - aside, top + aside, foot + aside)
    edges = np.cumsum([0.0, high, _WALL_M[0], high])
    sides = np.column_stack([left, np.zeros(len(left))])
    outward = (-sides, np.broadcast_to(rise(1.0), sides.shape), sides)
    gain = np.ones((_WALL_LIGHT_ROWS, len(feet)), np.float32)
    for k, normal in enumerate(outward):
        sheet = [np.column_stack([arc, np.full(len(arc), v)]) for v in edges[k : k + 2]]
        mesh.add(
            np.concatenate(lines[k : k + 2]), grid_triangles(2, len(feet))[:, ::-1], np.concatenate(sheet)
        )
        first, last = np.rint(_WALL_LIGHT_ROWS * edges[k : k + 2] / edges[-1]).astype(int)
        gain[first:last] = light.gain(top + 0.2 * normal, normal)
    for end, side in ((0, 1.0), (-1, -1.0)):
        corners = [top + side * aside, top - side * aside, foot - side * aside, foot + side * aside]
        mesh.quad(np.array([line[end] for line in corners]), (0.0, 0.0), (_WALL_M[0], high))
    for spot, crest in zip(feet, top, strict=True):
        light.shade_round(spot[:2], 0.6, float(crest[2]))
    return Piece.of(mesh, sheet_m, "field wall", label, gain)


def barn(
    foot: np.ndarray, turn_rad: float, size_m: tuple[float, float, float], label: str, light: Daylight
) -> Piece:
    """A barn with a pitched roof; ``light`` takes its shadow.

    Args:
        foot: (3,) middle of its floor, at the lowest ground under it.
        turn_rad: direction of its ridge.
        size_m: length along the ridge, width, height of the ridge.
        label, light: as of all pieces.
    """
    length, wide, high = size_m
    along = np.array([np.cos(turn_rad), np.sin(turn_rad), 0.0])
    left = np.array([-along[1], along[0], 0.0])
    eaves = _EAVES_SHARE * high
    slope = float(np.hypot(wide / 2, high - eaves))
    sheet_m = (2 * (length + wide), high + slope)
    mesh = Mesh()
    gain = np.ones((2, 40), np.float32)
    at = 0.0
    for outward, across, side, reach in (
        (left, -along, length, wide / 2),
        (along, left, wide, length / 2),
        (-left, along, length, wide / 2),
        (-along, -left, wide, length / 2),
    ):
        middle = foot + reach * outward
        ends = [middle - side / 2 * across, middle + side / 2 * across]
        top = eaves if side == length else high
        if side == length:
            _wall(mesh, ends, eaves, (at, slope + high - eaves))
        else:
            _gable(mesh, ends, (eaves, high), (at, slope))
        lit = float(light.gain(middle + rise(0.6 * top) + 0.5 * outward, outward))
        gain[:, round(40 * at / sheet_m[0]) : round(40 * (at + side) / sheet_m[0])] = lit
        at += side
    _roof(mesh, foot, (along, left), size_m, slope)
    rows = np.repeat(gain, 10, axis=0)
    roof_rows = max(1, round(20 * slope / sheet_m[1]))
    for k, outward in enumerate((left, -left)):
        normal = (high - eaves) * outward + rise(wide / 2)
        normal /= np.linalg.norm(normal)
        rows[:roof_rows, k * 20 : (k + 1) * 20] = light.gain(foot + rise(high + 1.0), normal)
    corners = [foot + x * length / 2 * along + y * wide / 2 * left for x, y in _SQUARE]
    light.shade_polygon(np.array(corners)[:, :2], foot[2] + 0.5 * (eaves + high))
    return Piece.of(mesh, sheet_m, "barn", label, rows)


def _wall(mesh: Mesh, ends: list[np.ndarray], high: float, low_m: tuple[float, float]) -> None:
    up, length = rise(high), float(np.linalg.norm(ends[1] - ends[0]))
    mesh.quad(np.array([ends[0] + up, ends[1] + up, ends[1], ends[0]]), low_m, (length, high))


def _gable(
    mesh: Mesh, ends: list[np.ndarray], heights: tuple[float, float], low_m: tuple[float, float]
) -> None:
    """A wall with a point, seen from outside."""
    eaves, high = heights
    middle, length = (ends[0] + ends[1]) / 2, float(np.linalg.norm(ends[1] - ends[0]))
    vertices = np.array([ends[0] + rise(eaves), middle + rise(high), ends[1] + rise(eaves), ends[1], ends[0]])
    u = np.array([0.0, 0.5, 1.0, 1.0, 0.0]) * length + low_m[0]
    v = low_m[1] + np.array([high - eaves, 0.0, high - eaves, high, high])
    mesh.add(vertices, np.array([[0, 2, 1], [0, 4, 3], [0, 3, 2]]), np.column_stack([u, v]))


def _roof(
    mesh: Mesh,
    foot: np.ndarray,
    ways: tuple[np.ndarray, np.ndarray],
    size_m: tuple[float, float, float],
    slope_m: float,
) -> None:
    """Two slopes with a small overhang, side by side in the upper part of the sheet."""
    (along, left), (length, wide, high) = ways, size_m
    eaves, over = _EAVES_SHARE * high, 1.06
    half = length + wide
    for k, side in enumerate((1.0, -1.0)):
        out, across = side * left, -side * along
        ridge = foot + rise(high + 0.03)
        edge = foot + over * wide / 2 * out + rise(high - over * (high - eaves) + 0.03)
        ends = [-over * length / 2 * across, over * length / 2 * across]
        corners = np.array([ridge + ends[0], ridge + ends[1], edge + ends[1], edge + ends[0]])
        mesh.quad(corners, (k * half, 0.0), (half, slope_m))
        mesh.quad(corners[[1, 0, 3, 2]], (k * half, 0.0), (half, slope_m))
