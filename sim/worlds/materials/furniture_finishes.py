"""Faces of furniture and fittings."""

from itertools import pairwise

import cv2
import numpy as np

from dslab.sim.worlds.materials import motifs
from dslab.sim.worlds.materials.textures import add_noise, dead_leaves, grain, text_block


def bookshelf(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Shelves full of books."""
    height = image.shape[0]
    image[:] = 60
    shelves = max(1, round(height / scale / 0.33))
    board = max(2, round(0.02 * scale))
    for top in np.linspace(0, height, shelves + 1)[:-1].astype(int):
        motifs.books(image[top + board : top + height // shelves], scale, rng)
        image[top : top + board] = 190
    motifs.frame(image, board, 175)
    add_noise(image, rng, 9, 0.8)


def cabinet(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Doors with handles, labels and scratches."""
    height, width = image.shape
    image[:] = int(rng.integers(90, 200))
    grain(image, rng, 14, vertical=True)
    doors = max(1, round(width / scale / 0.5))
    edges = np.linspace(0, width, doors + 1).astype(int)
    for left, right in pairwise(edges):
        door_face = image[:, left:right]
        motifs.frame(door_face, 0.006 * scale, 35)
        motifs.crop(door_face, scale, 0.06, 0.4 * height / scale, (0.03, 0.16))[:] = 20
        label = motifs.crop(door_face, scale, 0.14, rng.uniform(0.1, 0.6) * height / scale, (0.25, 0.2))
        if min(label.shape) >= 16:
            motifs.poster(label, scale, rng)
    _wear(image, scale, rng)


def crate(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Cardboard or wood with stencilled letters and labels."""
    height, width = image.shape
    image[:] = int(rng.integers(110, 170))
    grain(image, rng, 12, vertical=False)
    title = image[height // 8 : height // 2, width // 10 : -(width // 10) or None]
    motifs.lettering(title, rng, int(rng.integers(3, 7)), 35)
    lower = image[5 * height // 8 : 7 * height // 8]
    text_block(lower[:, width // 8 : width // 2], rng, max(2.0, 0.025 * scale), 40)
    label = lower[:, 5 * width // 8 : 7 * width // 8]
    if min(label.shape) >= 16:
        motifs.poster(label, scale, rng)
    _wear(image, scale, rng)
    motifs.frame(image, 0.012 * scale, 50)


def machine(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A switchboard: plates with dials, vents, type labels and dirt."""
    height, width = image.shape
    image[:] = 140
    cell = max(16, round(0.22 * scale))
    for y in range(0, height - cell // 2, cell):
        for x in range(0, width - cell // 2, cell):
            _instrument(image[y : y + cell - 2, x : x + cell - 2], scale, rng)
    _wear(image, scale, rng)


def _instrument(plate: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    plate[:] = int(rng.integers(60, 215))
    kind = rng.integers(4)
    if kind == 0:
        motifs.vent(plate, scale, rng)
    elif kind == 1:
        motifs.lettering(plate, rng, int(rng.integers(2, 4)), 20)
    elif kind == 2:
        centre, radius = (plate.shape[1] // 2, plate.shape[0] // 2), max(2, min(plate.shape) // 3)
        turn = rng.uniform(0, 2 * np.pi)
        tip = (int(centre[0] + radius * np.cos(turn)), int(centre[1] + radius * np.sin(turn)))
        cv2.circle(plate, centre, radius, 235, -1)
        cv2.line(plate, centre, tip, 20, 2)
    else:
        dead_leaves(plate, scale, rng, 500, (0.01, 0.04))


def door(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A door with a glazed or lettered upper half, a panel, a handle and a frame."""
    height, width = image.shape
    image[:] = int(rng.integers(90, 190))
    grain(image, rng, 14, vertical=True)
    upper = image[height // 10 : 2 * height // 5, width // 5 : -(width // 5) or None]
    if min(upper.shape) >= 16:
        (motifs.window if rng.random() < 0.4 else motifs.poster)(upper, scale, rng)
    lower = image[height // 2 : 9 * height // 10, width // 6 : -(width // 6) or None]
    motifs.frame(lower, 0.012 * scale, 50)
    dead_leaves(lower, scale, rng, 60, (0.01, 0.06))
    motifs.crop(image, scale, 0.06, 0.5 * height / scale, (0.14, 0.03))[:] = 20
    _wear(image, scale, rng)
    motifs.frame(image, 0.03 * scale, 215)


def pipe(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A painted duct: bands along it, lettering, rust."""
    image[:] = int(rng.integers(120, 190))
    for _ in range(max(1, round(max(image.shape) / scale / 0.5))):
        start, wide = int(rng.integers(image.shape[1])), max(2, round(rng.uniform(0.01, 0.12) * scale))
        image[:, start : start + wide] = int(rng.integers(30, 235))
    dead_leaves(image, scale, rng, 200, (0.006, 0.04))
    add_noise(image, rng, 16, 0.85)


def _wear(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Chips, specks and noise at all scales."""
    dead_leaves(image, scale, rng, 45, (0.004, 0.04), smallest_px=0.6)
    add_noise(image, rng, 13, 0.8)
