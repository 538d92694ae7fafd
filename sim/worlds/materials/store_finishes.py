"""Finishes of a warehouse: racks with goods, floor, cladding, roof."""

import numpy as np

from dslab.sim.worlds.materials import motifs
from dslab.sim.worlds.materials.furniture_finishes import crate
from dslab.sim.worlds.materials.textures import add_noise, dead_leaves, multiply

RACK_CELLS = (4, 5)
"""Columns and rows of a rack's sheet: goods, in the last row steel and the dark behind the goods."""


def rack(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A sheet of different crates, with painted steel in its last row."""
    columns, rows = RACK_CELLS
    high, wide = image.shape[0] // rows, image.shape[1] // columns
    for row in range(rows - 1):
        for column in range(columns):
            cell = image[row * high : (row + 1) * high, column * wide : (column + 1) * wide]
            if min(cell.shape) >= 16:
                crate(cell, scale, rng)
            gain = rng.uniform(0.5, 1.35)
            cell[:] = np.clip(cell * gain, 5, 245).astype(np.uint8)
    steel = image[(rows - 1) * high :]
    steel[:] = int(rng.choice([70, 95, 150, 180]))
    dead_leaves(steel, scale, rng, 60, (0.012, 0.07), (40, 230))
    shadow = steel[3 * high // 4 :]
    shadow[:] = 34
    dead_leaves(shadow, scale, rng, 20, (0.03, 0.2), (15, 75))
    add_noise(steel, rng, 14, 0.85)


def floor(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Polished concrete: joints, tyre marks, chips, a painted lane line, some numbers."""
    add_noise(image, rng, 8, 0.7)
    motifs.stains(image, scale, rng, 0.25)
    dead_leaves(image, scale, rng, 7, (0.012, 0.07), (75, 185))
    motifs.cracks(image, scale, rng, 5)
    joint = max(1, round(0.015 * scale))
    image[:joint] = image[:, :joint] = 60
    line = max(2, round(0.08 * scale))
    at = int(image.shape[0] * rng.uniform(0.1, 0.9))
    image[at : at + line] = 215
    if rng.random() < 0.5:
        place = motifs.crop(image, scale, rng.uniform(0, 1.5), rng.uniform(0, 1.5), (1.0, 0.6))
        if place.size:
            motifs.lettering(place, rng, 3, 210)
            # A floor's sheet is seen from its back.
            place[:] = place[::-1].copy()
    add_noise(image, rng, 5, 0.95)


def cladding(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Ribbed metal sheets in rows of screws, scuffed and streaked, with posters, boxes and pipes."""
    image[:] = 150
    rib = max(3, round(0.2 * scale))
    for start in range(0, image.shape[1], rib):
        image[:, start : start + rib // 8 + 1] = 132
        image[:, start + rib // 8 + 1 : start + rib // 4 + 1] = 160
    height, width = image.shape
    for y in np.arange(rng.uniform(0.1, 0.5), height / scale, 0.9):
        image[int(y * scale) : int(y * scale) + 2, rib // 16 :: rib] = 62
    multiply(image, rng.uniform(0.8, 1.06, (3, max(2, width // 9))))
    add_noise(image, rng, 12, 0.85)
    motifs.stains(image, scale, rng, 0.5)
    dead_leaves(image, scale, rng, 9, (0.012, 0.07), (85, 190))
    scuffed = image[int(0.7 * height) :]
    dead_leaves(scuffed, scale, rng, 22, (0.015, 0.1), (70, 200))
    motifs.cables(image, scale, rng)
    for _ in range(int(rng.integers(2, 6))):
        size = (rng.uniform(0.5, 1.4), rng.uniform(0.4, 1.2))
        x, y = rng.uniform(0, max(0.1, width / scale - 1)), rng.uniform(0.3, 0.85) * height / scale
        place = motifs.crop(image, scale, x, y, size)
        if min(place.shape) >= 16:
            (motifs.poster if rng.random() < 0.6 else motifs.vent)(place, scale, rng)


def roof(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Trapezoidal sheets, trusses across, skylights and lamps."""
    image[:] = 120
    image[:: max(2, round(0.3 * scale))] = 90
    height, width = image.shape
    light = image[height // 3 : 2 * height // 3, width // 8 : width // 3]
    light[:] = 225
    motifs.frame(light, 0.05 * scale, 70)
    lamp = image[height // 4 : 3 * height // 4, int(0.7 * width) : int(0.76 * width)]
    lamp[:] = 245
    image[:, int(0.52 * width) : int(0.56 * width)] = 45
    add_noise(image, rng, 9, 0.8)
    dead_leaves(image, scale, rng, 2, (0.03, 0.2), (50, 190))
