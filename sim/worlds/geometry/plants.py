"""Trees, bushes, hedges, woods: dark blobs of foliage covered by small ragged faces."""

import numpy as np

from dslab.sim.worlds.geometry.meshes import Mesh, Piece, bumpy_ball, grid_triangles, rise
from dslab.sim.worlds.geometry.route import Stretch

_SHEET_M = (6.0, 5.0)
_BARK_M = (5.25, 0.75)  # where the bark begins on the sheet, and how wide it is
_BLOBS, _FACES_PER_BLOB = 5, 60
_FACE_CORNERS = 5
_RINGS, _SIDES = 5, 8
_WHORLS = 8
_WOODS_STEP_M, _THINNING_M = 0.8, 7.0
_SQUASHED = np.array([1.0, 1.0, 0.85])


def tree(spot: np.ndarray, height_m: float, label: str, rng: np.random.Generator) -> Piece:
    """A broad-leaved tree with the foot of its trunk at ``spot`` (3,)."""
    mesh = Mesh()
    crown_m = 0.33 * height_m
    fork = spot + np.array([0.1, 0.08, 0.62 * height_m]) * rng.uniform([-1, -1, 0.95], [1, 1, 1.05])
    thick = 0.022 * height_m
    mesh.tube(np.array([spot, fork]), (thick, 0.55 * thick), 7, (_BARK_M[0], 0.0), (_BARK_M[1], _SHEET_M[1]))
    middle = spot + rise(height_m - 1.05 * crown_m)
    for k in range(_BLOBS):
        turn = 2 * np.pi * (k + rng.random()) / _BLOBS
        away = np.array([np.cos(turn), np.sin(turn), 0]) * rng.uniform(0.3, 0.55)
        away[2] = rng.uniform(-0.35, 0.5)
        _blob(mesh, middle + crown_m * away, crown_m * rng.uniform(0.55, 0.75), rng)
    return Piece.of(mesh, _SHEET_M, "tree", label)


def bush(spot: np.ndarray, height_m: float, label: str, rng: np.random.Generator) -> Piece:
    """A bush without a trunk."""
    mesh = Mesh()
    for _ in range(2):
        aside = rng.uniform([-0.4, -0.4, 0.3], [0.4, 0.4, 0.45]) * height_m
        _blob(mesh, spot + aside, height_m * rng.uniform(0.45, 0.55), rng)
    return Piece.of(mesh, _SHEET_M, "tree", label, detail=0.6)


def conifer(spot: np.ndarray, height_m: float, label: str, rng: np.random.Generator) -> Piece:
    """A spruce: whorls that narrow to a tip."""
    mesh = Mesh()
    trunk = np.array([spot, spot + rise(0.5 * height_m)])
    mesh.tube(trunk, (0.02 * height_m, 0.012 * height_m), 7, (_BARK_M[0], 0.0), (_BARK_M[1], _SHEET_M[1]))
    for share in 1 - np.geomspace(0.8, 0.06, _WHORLS):
        radius = height_m * (0.03 + 0.19 * (1 - share)) * rng.uniform(0.9, 1.15)
        _blob(mesh, spot + rise(share * height_m), radius, rng)
    return Piece.of(mesh, _SHEET_M, "tree", label)


def hedge(feet: np.ndarray, height_m: float, label: str, rng: np.random.Generator) -> Piece:
    """A hedge of uneven height along feet (n, 3), about ``height_m`` apart."""
    mesh = Mesh()
    for foot in feet:
        high = height_m * rng.uniform(0.75, 1.15)
        aside = rng.uniform([-0.15, -0.15, 0.4], [0.15, 0.15, 0.5]) * high
        _blob(mesh, foot + aside, high * rng.uniform(0.55, 0.65), rng)
    return Piece.of(mesh, _SHEET_M, "tree", label, detail=0.6)


def ragged_woods(
    ends: np.ndarray,
    high: float,
    label: str,
    rng: np.random.Generator,
    closed: tuple[bool, bool] = (True, True),
) -> Piece:
    """The edge of a distant wood: two rows of crowns with undergrowth before them.

    Args:
        ends: (2, 2) plan points, left to right as seen.
        high: of the highest crowns, metres.
        label, rng: as of all plants.
        closed: the wood continues beyond both ends; otherwise it thins out.
    """
    line = Stretch(*ends)
    back, sheet = line.left, (line.length_m, 2 * high)
    mesh = Mesh()
    for depth, share, low in ((3.5, 1.0, 0.0), (0.0, 0.8, 0.6 * high), (-1.5, 0.25, 1.6 * high)):
        row = np.array([ends[0] + depth * back, ends[1] + depth * back])
        _crowns(mesh, row, share * high, (0.0, low), rng, closed)
    return Piece.of(mesh, sheet, "woods", label)


def _crowns(
    mesh: Mesh,
    ends: np.ndarray,
    high: float,
    low_m: tuple[float, float],
    rng: np.random.Generator,
    closed: tuple[bool, bool],
) -> None:
    """An upright face whose top is a row of crowns with ragged rims."""
    wide = float(np.linalg.norm(ends[1] - ends[0]))
    at = np.linspace(0, wide, max(8, round(wide / _WOODS_STEP_M)) + 1)
    centres = np.arange(-1.0, wide + 2.0, 0.32 * high) + rng.uniform(-0.06, 0.06) * high
    tops, reach = high * rng.uniform(0.75, 1.0, len(centres)), high * rng.uniform(0.2, 0.32, len(centres))
    domes = tops - 0.3 * high * ((at[:, None] - centres) / reach) ** 2
    top = np.maximum(domes.max(axis=1), 0.55 * high) + high * rng.uniform(-0.02, 0.02, len(at))
    top = np.minimum(top, high)
    for shut, away in zip(closed, (at, wide - at), strict=True):
        if not shut:
            top *= np.clip(away / _THINNING_M, 0.04, 1) ** 0.6
    plan = ends[0] + (at / wide)[:, None] * (ends[1] - ends[0])
    rows = [np.column_stack([plan, top]), np.column_stack([plan, np.full(len(at), -0.4)])]
    v = [low_m[1] + high - top, np.full(len(at), low_m[1] + high)]
    sheet = [np.column_stack([low_m[0] + at, level]) for level in v]
    mesh.add(np.vstack(rows), grid_triangles(2, len(at)), np.vstack(sheet))


def _blob(mesh: Mesh, centre: np.ndarray, radius_m: float, rng: np.random.Generator) -> None:
    """A bumpy ball, and faces at and about its surface that look mostly outward."""
    ball, bumps = bumpy_ball(_RINGS + 1, _SIDES, (0.72, 0.95), rng)
    points = (centre + radius_m * _SQUASHED * bumps * ball).reshape(-1, 3)
    low, size = rng.uniform([0, 0], [2.4, 2.2]), np.array([2.6, 2.6])
    u, v = np.meshgrid(np.linspace(0, 1, _SIDES + 1), np.linspace(0, 1, _RINGS + 1))
    mesh.add(
        points, grid_triangles(_RINGS + 1, _SIDES + 1), low + size * np.column_stack([u.ravel(), v.ravel()])
    )
    _coat(mesh, centre, radius_m, rng)


def _coat(mesh: Mesh, centre: np.ndarray, radius_m: float, rng: np.random.Generator) -> None:
    """Irregular pentagons, each with its own bit of the leaves."""
    count, corners = _FACES_PER_BLOB, _FACE_CORNERS
    out = rng.standard_normal((count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    middle = centre + radius_m * _SQUASHED * out * rng.uniform(0.85, 1.08, (count, 1))
    normal = out + 0.5 * rng.standard_normal((count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    across = np.cross(normal, rng.standard_normal((count, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    upward = np.cross(normal, across)
    turn = 2 * np.pi * np.arange(corners) / corners
    reach = radius_m * rng.uniform(0.12, 0.3, (count, corners))
    plane = np.stack([reach * np.cos(turn), reach * np.sin(turn)], axis=-1)
    points = middle[:, None] + plane[..., :1] * across[:, None] + plane[..., 1:] * upward[:, None]
    sheet = rng.uniform([0.7, 0.7], [4.5, 4.3], (count, 2))[:, None] + plane
    k = np.arange(1, corners - 1)
    fan = np.column_stack([0 * k, k, k + 1])
    faces = (fan[None] + corners * np.arange(count)[:, None, None]).reshape(-1, 3)
    mesh.add(points.reshape(-1, 3), faces, np.clip(sheet.reshape(-1, 2), 0.05, (5.1, 4.95)))
