"""Finishes of kept rooms: smooth surfaces without wear, and fine ones that look like themselves everywhere.

The first leave parts of the image without corners; on the second, neighbours are easily mistaken for one
another.
"""

from itertools import pairwise

import cv2
import numpy as np

from dslab.sim.worlds.materials import motifs
from dslab.sim.worlds.materials.textures import add_noise, grain, text_block

_GRAIN_LEVELS = 1.5  # of paint and lacquer
_TILE_M, _CARPET_M, _STRIPE_M = 0.1, 0.5, 0.025


def painted(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A painted wall: some prints and notices pinned up, a socket, otherwise nothing."""
    _lacquer(image, 150, rng)
    _prints(image, scale, rng)


def small_tiles(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Glazed tiles in a square grid, every other one of every other row dark, prints stuck on some."""
    side = max(4.0, _TILE_M * scale)
    row, column = ((np.arange(n) / side).astype(int) for n in image.shape)
    image[:] = np.where((row % 2)[:, None] * (column % 2), 85, 150)
    _joints(image, side, side, 120)
    _shine(image, rng, 3)
    _prints(image, scale, rng)


def striped_carpet(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Carpet tiles of one pattern of fine broken stripes, every other one turned."""
    height, width = image.shape
    side = max(8, round(_CARPET_M * scale))
    stripes = max(2, round(_CARPET_M / _STRIPE_M))
    threads = rng.integers(70, 170, (stripes, 1)) + 45 * (rng.random((stripes, 6)) < 0.3)
    pattern = cv2.resize(threads.astype(np.uint8), (side, side), interpolation=cv2.INTER_NEAREST)
    patterns = pattern, np.ascontiguousarray(pattern.T)
    for row, top in enumerate(range(0, height, side)):
        for column, left in enumerate(range(0, width, side)):
            tile = image[top : top + side, left : left + side]
            tile[:] = patterns[(row + column) % 2][: tile.shape[0], : tile.shape[1]]
    add_noise(image, rng, 2, 0.95)


def smooth_ceiling(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """White panels with thin joints."""
    _lacquer(image, 190, rng)
    _joints(image, 0.6 * scale, 0.6 * scale, 150)


def plain_front(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Lacquered doors with thin joints and a bar as handle, dark or light."""
    height, width = image.shape
    _lacquer(image, int(rng.choice((60, 75, 190))), rng)
    doors = max(1, round(width / scale / 0.5))
    edges = np.linspace(0, width, doors + 1).astype(int)
    for left, right in pairwise(edges):
        face = image[:, left:right]
        motifs.frame(face, 0.003 * scale, 25)
        wide = (right - left) / scale
        motifs.crop(face, scale, 0.25 * wide, min(0.06, 0.1 * height / scale), (0.5 * wide, 0.018))[:] = 235


def table_top(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Smooth wood with papers and magazines lying on it."""
    _lacquer(image, 150, rng)
    grain(image, rng, 6, vertical=False)
    _joints(image, 0.8 * scale, 0.8 * scale, 100)
    width, height = image.shape[1] / scale, image.shape[0] / scale
    for _ in range(1 + rng.poisson(3 * width * height)):
        _sheet(image, scale, rng, rng.uniform(0, width), rng.uniform(0, height), (0.21, 0.29))


def _prints(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Sheets in two rows at the height of eyes and hands, and a socket."""
    height, width = image.shape[0] / scale, image.shape[1] / scale
    for _ in range(rng.poisson(1.2 * width)):
        size = ((0.21, 0.3), (0.3, 0.21), (0.15, 0.21))[rng.integers(3)]
        at = height - rng.choice((1.5, 1.15)) + rng.uniform(-0.05, 0.05)
        _sheet(image, scale, rng, rng.uniform(0, max(0.01, width - size[0])), at, size)
    socket = motifs.crop(image, scale, rng.uniform(0, width), height - 0.3, (0.08, 0.08))
    if min(socket.shape) >= 4:
        socket[:] = 225
        motifs.frame(socket, 0.004 * scale, 90)


def _sheet(
    image: np.ndarray,
    scale: float,
    rng: np.random.Generator,
    x_m: float,
    y_m: float,
    size_m: tuple[float, float],
) -> None:
    """A print: the cover of a magazine, or a page of text."""
    sheet = motifs.crop(image, scale, x_m, y_m, size_m)
    if min(sheet.shape) < 16:
        return
    if rng.random() < 0.5:
        motifs.poster(sheet, scale, rng)
    else:
        sheet[:] = 235
        text_block(sheet[4:-4, 4:-4], rng, max(2.0, 0.012 * scale), 40)
        motifs.frame(sheet, 0.5, 90)


def _lacquer(image: np.ndarray, level: int, rng: np.random.Generator) -> None:
    image[:] = level
    _shine(image, rng, 6)
    add_noise(image, rng, _GRAIN_LEVELS, 0.9)


def _shine(image: np.ndarray, rng: np.random.Generator, levels: float) -> None:
    """Broad gradients of light, without an edge."""
    coarse = rng.normal(0, levels, (3, 4)).astype(np.float32)
    broad = cv2.resize(coarse, image.shape[::-1], interpolation=cv2.INTER_CUBIC)
    cv2.add(image, broad, dst=image, dtype=cv2.CV_8U)


def _joints(image: np.ndarray, wide_px: float, high_px: float, level: int) -> None:
    height, width = image.shape
    for column in np.arange(wide_px, width, max(8.0, wide_px)).astype(int):
        image[:, column : column + 1] = level
    for row in np.arange(high_px, height, max(8.0, high_px)).astype(int):
        image[row : row + 1] = level
