"""Lamp posts, signs, poles and other upright things."""

import numpy as np

from dslab.sim.worlds.geometry.meshes import Mesh, Piece, rise


def lamp_post(spot: np.ndarray, towards: np.ndarray, label: str) -> Piece:
    """A lamp post with its foot at ``spot`` (3,), whose arm reaches over the road, ``towards`` (2,)."""
    mesh, over = Mesh(), np.append(towards, 0.0)
    top, sheet = spot + rise(6.6), ((0.0, 0.0), (0.35, 3.0))
    mesh.tube(np.array([spot, spot + rise(1.1)]), (0.13, 0.12), 8, *sheet)
    mesh.tube(np.array([spot + rise(1.1), top]), (0.085, 0.05), 8, *sheet)
    mesh.tube(np.array([top, top + 1.3 * over + rise(0.35)]), (0.05, 0.035), 6, *sheet)
    mesh.tube(
        np.array([top + 1.2 * over + rise(0.32), top + 1.9 * over + rise(0.42)]), (0.1, 0.14), 6, *sheet
    )
    return Piece.of(mesh, (0.36, 3.0), "metal", label)


def sign_post(spot: np.ndarray, facing: np.ndarray, size_m: tuple[float, float], label: str) -> Piece:
    """A plate with letters, turned ``facing`` (2,) to its readers, on a post at ``spot`` (3,)."""
    mesh, front = Mesh(), np.append(facing, 0.0)
    right = np.array([-facing[1], facing[0], 0.0])
    wide, high = size_m
    foot = max(0.9, 2.3 - 0.2 * high)
    for aside in (-0.35 * wide, 0.35 * wide) if wide > 1.2 else (0.0,):
        base = spot + aside * right
        ends = np.array([base, base + rise(foot + high)])
        mesh.tube(ends, (0.045, 0.045), 6, (0.0, high), (0.4, high))
    _plate(mesh, spot + 0.06 * front + rise(foot + high / 2), facing, size_m)
    return Piece.of(mesh, (wide, 2 * high), "sign", label)


def hung_sign(centre: np.ndarray, facing: np.ndarray, size_m: tuple[float, float], label: str) -> Piece:
    """A hanging plate with letters about ``centre`` (3,); see ``sign_post``."""
    mesh = Mesh()
    _plate(mesh, centre, facing, size_m)
    return Piece.of(mesh, (size_m[0], 2 * size_m[1]), "sign", label)


def _plate(mesh: Mesh, centre: np.ndarray, facing: np.ndarray, size_m: tuple[float, float]) -> None:
    """Front and back of a plate; the sheet has letters above, bare metal below."""
    wide, high = size_m
    front, right = np.append(facing, 0.0), np.array([-facing[1], facing[0], 0.0])
    for side, low in ((1.0, (0.0, 0.0)), (-1.0, (0.0, high))):
        near = centre - (0.02 * front if side < 0 else 0.0)
        corners = [
            near + (u * side * wide / 2) * right + rise(v * high / 2)
            for u, v in ((-1, 1), (1, 1), (1, -1), (-1, -1))
        ]
        mesh.quad(np.array(corners), low, (wide, high))


def bollards(start: np.ndarray, end: np.ndarray, spacing_m: float, label: str) -> Piece:
    """A row of short posts between two feet (3,)."""
    mesh = Mesh()
    count = max(2, int(np.linalg.norm(end - start) / spacing_m))
    for k in range(count):
        foot = start + (end - start) * k / (count - 1)
        low = (0.0, 0.1 * (k % 8))
        mesh.tube(np.array([foot, foot + rise(0.95)]), (0.08, 0.07), 7, low, (0.5, 0.9))
        mesh.tube(np.array([foot + rise(0.95), foot + rise(1.02)]), (0.07, 0.001), 7, low, (0.5, 0.1))
    return Piece.of(mesh, (0.5, 1.8), "metal", label)
