"""The ground of a town: carriageways, crossings, and raised pavements with their kerbs."""

from itertools import pairwise

import numpy as np

from dslab.sim.worlds.geometry.meshes import Mesh, Piece
from dslab.sim.worlds.geometry.outdoor import Daylight, ground_gain, ground_piece
from dslab.sim.worlds.materials.street_finishes import KERB_SHARE
from dslab.sim.worlds.town.streets import CARRIAGEWAY_M, FRONT_M, Plan, Street

KERB_M = 0.13
_LONGEST_M = 14.0


def carriageways(plan: Plan, street: Street, light: Daylight) -> list[Piece]:
    """The carriageway of a street and the crossings that it owns."""
    rank = plan.streets.index(street)
    pieces = []
    corner_left = CARRIAGEWAY_M
    owned = plan.free(street, 0.0, 0.0, CARRIAGEWAY_M)
    crossings = [
        (low, high)
        for low, high in _gaps(plan.free(street, 0.0, CARRIAGEWAY_M), street.length_m)
        if any(a - 1e-6 <= low and high <= b + 1e-6 for a, b in _merged(owned))
    ]
    parts = [(span, "asphalt") for span in plan.free(street, 0.0, CARRIAGEWAY_M)]
    parts += [(span, "crossing") for span in crossings]
    for (low, high), finish in parts:
        for a, b in _cut(low, high, _LONGEST_M if finish == "asphalt" else np.inf):
            corner = street.point(a, corner_left)
            size = (b - a, 2 * CARRIAGEWAY_M)
            label = f"road {rank},{len(pieces)}"
            pieces.append(ground_piece(corner, street.way, size, finish, label, light))
    return pieces


def pavements(plan: Plan, street: Street, light: Daylight) -> list[Piece]:
    """The raised strips on both sides, kerb towards the road and at crossing roads."""
    rank = plan.streets.index(street)
    pieces = []
    for side in (1.0, -1.0):
        middle = side * (CARRIAGEWAY_M + FRONT_M) / 2
        for low, high in plan.free(street, middle, CARRIAGEWAY_M, FRONT_M):
            spans = _cut(low, high, _LONGEST_M)
            for k, (a, b) in enumerate(spans):
                ends = (k == 0 and low > 0.0, k == len(spans) - 1 and high < street.length_m)
                label = f"pavement {rank},{len(pieces)}"
                pieces.append(_strip(street, side, (a, b), ends, label, light))
    return pieces


def _strip(
    street: Street,
    side: float,
    span: tuple[float, float],
    open_ends: tuple[bool, bool],
    label: str,
    light: Daylight,
) -> Piece:
    """One length of pavement; its sheet has the houses above and the kerb's face below."""
    length = span[1] - span[0]
    wide = FRONT_M - CARRIAGEWAY_M
    high = wide / (1 - KERB_SHARE)
    # Seen from the road, the sheet's left end is the near one on the left-hand side, the far one otherwise.
    along = street.way if side > 0 else -street.way
    start = street.point(span[0] if side > 0 else span[1], side * CARRIAGEWAY_M)
    inward = side * street.left
    flags = open_ends if side > 0 else open_ends[::-1]

    def at(along_m: float, in_m: float, z_m: float) -> np.ndarray:
        return np.append(start + along_m * along + in_m * inward, z_m)

    mesh = Mesh()
    mesh.quad(
        np.array([at(0, wide, KERB_M), at(length, wide, KERB_M), at(length, 0, KERB_M), at(0, 0, KERB_M)]),
        (0.0, 0.0),
        (length, wide),
    )
    face = (0.0, wide), (length, high - wide)
    mesh.quad(np.array([at(0, 0, KERB_M), at(length, 0, KERB_M), at(length, 0, 0), at(0, 0, 0)]), *face)
    if flags[0]:
        mesh.quad(np.array([at(0, wide, KERB_M), at(0, 0, KERB_M), at(0, 0, 0), at(0, wide, 0)]), *face)
    if flags[1]:
        end = np.array(
            [at(length, 0, KERB_M), at(length, wide, KERB_M), at(length, wide, 0), at(length, 0, 0)]
        )
        mesh.quad(end, *face)
    gain = ground_gain(start + wide * inward, along, (length, high), light, KERB_M)
    return Piece.of(mesh, (length, high), "paving", label, gain)


def _cut(low: float, high: float, longest: float) -> list[tuple[float, float]]:
    edges = np.linspace(low, high, max(1, int(np.ceil((high - low) / longest - 1e-9))) + 1).tolist()
    return list(pairwise(edges))


def _gaps(parts: list[tuple[float, float]], length_m: float) -> list[tuple[float, float]]:
    edges = [0.0, *(edge for part in parts for edge in part), length_m]
    return [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 1e-6]


def _merged(parts: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Join parts that touch."""
    joined: list[tuple[float, float]] = []
    for a, b in sorted(parts):
        if joined and a - joined[-1][1] < 1e-6:
            joined[-1] = (joined[-1][0], b)
        else:
            joined.append((a, b))
    return joined
