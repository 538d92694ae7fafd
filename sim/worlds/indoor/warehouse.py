"""A warehouse: rows of racks with goods, aisles, and a cross aisle at either end."""

import numpy as np

from dslab.scenarios.seeds import rng_for
from dslab.scenarios.worlds import WarehouseWorld
from dslab.sim.worlds.assembly import assemble_pieces
from dslab.sim.worlds.base import Route, WorldModel
from dslab.sim.worlds.geometry.meshes import Mesh, Piece
from dslab.sim.worlds.geometry.panels import Panel, slab, wall
from dslab.sim.worlds.geometry.route import rounded
from dslab.sim.worlds.geometry.twins import turned_piece
from dslab.sim.worlds.materials.store_finishes import RACK_CELLS
from dslab.sim.worlds.recurrence import is_alike

_AISLE_M, _RACK_M, _BAY_M, _CROSS_M = 3.0, 1.1, 2.7, 5.0
_CLEARANCE_M, _CORNER_M = 0.8, 1.1
_RETURN_M = 3.7  # the way back, beyond the racks' ends
_TURN_M = 1.4  # the turns from aisle to aisle, beyond the racks' ends
_SHEET_M = (3.2, 4.0)
_LEVEL_M = 1.7
_MIDDLE = np.zeros(2)


def layout(spec: WarehouseWorld, seed: int) -> Route:
    """Route up and down the aisles and back, the same for every seed."""
    del seed
    half = spec.length_m / 2
    corners = []
    for aisle, y in enumerate(_aisle_middles(spec).tolist()):
        ends = [(-half - _TURN_M, y), (half + _TURN_M, y)]
        corners += ends if aisle % 2 == 0 else ends[::-1]
    corners[0] = (-half - _RETURN_M, corners[0][1])
    corners[-1] = (-half - _RETURN_M, corners[-1][1])
    return Route(rounded(np.array(corners), _CORNER_M, True), _CLEARANCE_M, True)


def build_world(spec: WarehouseWorld, seed: int) -> WorldModel:
    """The warehouse with its textures."""
    rng = rng_for(seed, "world", "warehouse")
    twins = spec.twins
    racks: dict[tuple[int, float, int], Piece] = {}
    bays = max(3, round(spec.length_m / _BAY_M))
    edges = np.linspace(-spec.length_m / 2, spec.length_m / 2, bays + 1)
    for row, middle in enumerate(_aisle_middles(spec).tolist()):
        for side in (1.0, -1.0):
            front = middle + side * _AISLE_M / 2
            for bay, (low, high) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)):
                label = f"rack {row},{side:+.0f},{bay}"
                opposite = racks.get((spec.aisles - 1 - row, -side, bays - 1 - bay))
                if twins and opposite and is_alike(twins, seed, label):
                    racks[row, side, bay] = turned_piece(opposite, _MIDDLE)
                else:
                    racks[row, side, bay] = _bay((low, high), front, side, spec.height_m, label, rng)
    shell = [_piece(panel, spec.height_m) for panel in _shell(spec, half=bool(twins))]
    if twins:
        shell += [turned_piece(piece, _MIDDLE) for piece in shell]
    return assemble_pieces([*racks.values(), *shell], seed, spec.aliased)


def _aisle_middles(spec: WarehouseWorld) -> np.ndarray:
    """(aisles,) y of the middles of the aisles; two racks stand back to back between them."""
    pitch = _AISLE_M + 2 * _RACK_M
    return (np.arange(spec.aisles) - (spec.aisles - 1) / 2) * pitch


def _shell(spec: WarehouseWorld, half: bool) -> list[Panel]:
    """Floor, walls and roof, or such a half of them that half a turn gives the rest."""
    reach = np.array([spec.length_m / 2 + _CROSS_M, spec.aisles * (_AISLE_M / 2 + _RACK_M) + 0.3])
    corners = reach * [[-1, -1], [-1, 1], [1, 1], [1, -1]]
    top = spec.height_m + 1.0
    north = reach * [1, 0] if half else reach
    panels = slab(-reach, north, 0.0, True, "store floor", "floor", (4.2, 4.2))
    panels += slab(-reach, north, top, False, "store roof", "roof", (5.0, 5.0))
    for side, (start, end) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        if side < 2 or not half:
            panels += wall(start, end, (0.0, top), "cladding", f"wall {side}", 4.0)
    return panels


def _piece(panel: Panel, height_m: float) -> Piece:
    """Piece of a flat panel, darker at the top of walls and under racks."""
    mesh = Mesh()
    u, v = np.array([0.0, 1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0, 1.0])
    grown = panel.points(u + (2 * u - 1) * 1e-3, v + (2 * v - 1) * 1e-3)
    mesh.quad(grown, (0.0, 0.0), (panel.width_m, panel.height_m))
    upright = abs(panel.normal[2]) < 0.5 and panel.height_m > height_m / 2
    gain = np.array(
        [[0.85, 0.85], [1.0, 1.0], [0.9, 0.9]] if upright else [[1.0, 1.0], [1.0, 1.0]], np.float32
    )
    return Piece.of(mesh, (panel.width_m, panel.height_m), panel.finish, panel.label, gain)


def _bay(
    span: tuple[float, float],
    front_m: float,
    side: float,
    height_m: float,
    label: str,
    rng: np.random.Generator,
) -> Piece:
    """One bay: uprights, boards, goods of all sizes on every level, a dark back."""
    mesh = Mesh()
    along = 1.0 if side > 0 else -1.0
    start = span[0] if side > 0 else span[1]
    length = span[1] - span[0]

    def at(along_m: float, in_m: float, z_m: float) -> np.ndarray:
        return np.array([start + along * along_m, front_m + side * in_m, z_m])

    def box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float], low, size) -> None:
        """Append front, ends and top of a block; x[0] is its left end."""
        (x0, x1), (y0, y1), (z0, z1) = x, y, z
        mesh.quad(np.array([at(x0, y0, z1), at(x1, y0, z1), at(x1, y0, z0), at(x0, y0, z0)]), low, size)
        mesh.quad(np.array([at(x0, y1, z1), at(x0, y0, z1), at(x0, y0, z0), at(x0, y1, z0)]), low, size)
        mesh.quad(np.array([at(x1, y0, z1), at(x1, y1, z1), at(x1, y1, z0), at(x1, y0, z0)]), low, size)
        mesh.quad(np.array([at(x0, y1, z1), at(x1, y1, z1), at(x1, y0, z1), at(x0, y0, z1)]), low, size)

    cell = np.array(_SHEET_M) / RACK_CELLS
    steel = (0.0, float(_SHEET_M[1] - cell[1]))
    levels = np.arange(0.12, height_m - 0.8, _LEVEL_M).tolist()
    for x in (0.0, length - 0.1):
        for y in (0.0, _RACK_M - 0.1):
            box((x, x + 0.1), (y, y + 0.1), (0.0, height_m), steel, (0.15, 0.7 * cell[1]))
    back = np.array(
        [at(0, _RACK_M, height_m), at(length, _RACK_M, height_m), at(length, _RACK_M, 0), at(0, _RACK_M, 0)]
    )
    mesh.quad(back, (0.0, _SHEET_M[1] - 0.23 * cell[1]), (_SHEET_M[0], 0.2 * cell[1]))
    goods = rng.permutation(RACK_CELLS[0] * (RACK_CELLS[1] - 1)).tolist()
    for level, z in enumerate(levels):
        board = (steel[0], steel[1] + 0.08 * (level % 5))
        box((0.0, length), (0.02, _RACK_M), (z - 0.12, z), board, (_SHEET_M[0], 0.12))
        x = 0.15
        while x < length - 0.5:
            wide = min(rng.uniform(0.4, 1.1), length - 0.12 - x)
            if rng.random() < 0.92:
                # No crate twice in a bay while the sheet has others.
                goods.append(goods.pop(0))
                row, column = divmod(goods[-1], RACK_CELLS[0])
                depth = rng.uniform(0.03, 0.45)
                high = rng.uniform(0.6, _LEVEL_M - 0.3)
                box(
                    (x, x + wide),
                    (depth, _RACK_M - 0.02),
                    (z, z + high),
                    tuple(cell * [column, row]),
                    tuple(cell),
                )
            x += wide + rng.uniform(0.03, 0.15)
    return Piece.of(mesh, _SHEET_M, "rack", label)
