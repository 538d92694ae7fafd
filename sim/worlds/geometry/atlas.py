"""Joining of small neighbouring surfaces, since a renderer has a cost per surface."""

from collections.abc import Sequence

import numpy as np

from dslab.sim.worlds.base import Surface

_BORDER_PX = 4  # of repeated pixels around every texture, so that blurred lookups do not see its neighbours


def gathered(surfaces: Sequence[Surface], cell_m: Sequence[float], largest_px: int) -> list[Surface]:
    """Join the surfaces with small textures cell by cell.

    Args:
        surfaces: with unique labels.
        cell_m: (3,) size of the boxes of space in which small surfaces are joined.
        largest_px: surfaces with more texture pixels stay as they are.

    Returns:
        The large ones in their order, then one per cell, named after its first member.
    """
    large: list[Surface] = []
    cells: dict[tuple[int, ...], list[Surface]] = {}
    for surface in surfaces:
        if surface.texture.size > largest_px:
            large.append(surface)
            continue
        middle = (surface.vertices.min(axis=0) + surface.vertices.max(axis=0)) / 2
        key = tuple(np.floor(middle / cell_m).astype(int).tolist())
        cells.setdefault(key, []).append(surface)
    return large + [_joined(members) for members in cells.values()]


def _joined(members: list[Surface]) -> Surface:
    """One surface with all textures on one sheet, in rows of decreasing height."""
    order = sorted(members, key=lambda s: -s.texture.shape[0])
    places, size = _shelves([s.texture.shape for s in order])
    sheet = np.zeros(size, np.uint8)
    uv, triangles, count = [], [], 0
    for surface, (top, left) in zip(order, places, strict=True):
        height, width = surface.texture.shape
        sheet[top : top + height + 2 * _BORDER_PX, left : left + width + 2 * _BORDER_PX] = np.pad(
            surface.texture, _BORDER_PX, mode="edge"
        )
        corner = np.array([left, top]) + _BORDER_PX
        uv.append((corner + surface.uv * (width, height)) / (size[1], size[0]))
        triangles.append(surface.triangles + np.int32(count))
        count += len(surface.vertices)
    vertices = np.concatenate([s.vertices for s in order])
    label = f"{members[0].label} and {len(members) - 1} more"
    return Surface(vertices, np.concatenate(triangles), np.concatenate(uv), sheet, label)


def _shelves(shapes: list[tuple[int, ...]]) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    """Row and column of each texture with borders, and the smallest sheet's size."""
    padded = [(height + 2 * _BORDER_PX, width + 2 * _BORDER_PX) for height, width in shapes]
    widest = max(width for _, width in padded)
    tries = [_in_rows(padded, round(widest * 1.15**k)) for k in range(12)]
    return min(tries, key=lambda tried: tried[1][0] * tried[1][1])


def _in_rows(padded: list[tuple[int, int]], wide: int) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    places, top, left, shelf, used = [], 0, 0, 0, 0
    for height, width in padded:
        if left + width > wide:
            top, left, shelf = top + shelf, 0, 0
        places.append((top, left))
        left, shelf = left + width, max(shelf, height)
        used = max(used, left)
    return places, (top + shelf, used)
