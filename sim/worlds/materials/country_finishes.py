"""Finishes of the country: grass, rock, straw, timber, barns, woods, hills, skies."""

import cv2
import numpy as np

from dslab.sim.worlds.materials import motifs
from dslab.sim.worlds.materials.textures import (
    add_noise,
    blotches,
    courses,
    dead_leaves,
    fractal_noise,
    grain,
    multiply,
    shade,
)


def pasture(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Grass in tufts, grazed and dry places, molehills, flowers."""
    blotches(image, rng, max(2.0, 0.22 * scale), (84, 150))
    worn = fractal_noise((max(8, image.shape[0] // 16), max(8, image.shape[1] // 16)), rng, 0.8)
    multiply(image, np.clip(1 + 0.13 * worn, 0.65, 1.4))
    # At a low angle only features of decimetres remain visible on the ground: these need contrast.
    dead_leaves(image, scale, rng, 4.0, (0.07, 0.5), (50, 185))
    add_noise(image, rng, 9, 0.85)


def pasture_close(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Leaves, clover, pebbles and droppings."""
    dead_leaves(image, scale, rng, 16.0, (0.025, 0.12), (45, 150))
    add_noise(image, rng, 10, 0.85)


def field_wall(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Stones of all sizes laid dry, with deep dark joints and lichen."""
    courses(image, scale, rng, (rng.uniform(0.3, 0.45), rng.uniform(0.16, 0.22)), 0.43, 30)
    dead_leaves(image, scale, rng, 14.0, (0.08, 0.3), (60, 190))
    gaps = fractal_noise(image.shape, rng, 0.8)
    image[gaps > 1.9] = 48
    dead_leaves(image, scale, rng, 12.0, (0.02, 0.07), (80, 215))
    add_noise(image, rng, 12, 0.85)


def rock(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Weathered stone with lichen and cracks."""
    add_noise(image, rng, 24, 0.85)
    motifs.stains(image, scale, rng, 6.0)
    dead_leaves(image, scale, rng, 40, (0.02, 0.16), (70, 205))
    motifs.cracks(image, scale, rng, 6)
    add_noise(image, rng, 9, 0.95)


def straw(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A bale's sheet: stalks and twine above, its two spiral ends below."""
    width = image.shape[1]
    image[:] = 150
    grain(image, rng, 26, vertical=False)
    coat = round(image.shape[0] * 0.49)
    for y in np.linspace(0, coat, 9)[1:-1].astype(int):
        cv2.line(image, (0, int(y)), (width, int(y) + int(rng.integers(-3, 4))), 95, 1, cv2.LINE_AA)
    radius = (image.shape[0] - coat) // 2
    for middle in (radius, 3 * radius):
        turn = np.linspace(0, 18 * np.pi, 400)
        reach = radius * turn / turn[-1] * (1 + 0.02 * rng.standard_normal(400))
        path = np.column_stack([middle + reach * np.cos(turn), coat + radius + reach * np.sin(turn)])
        cv2.polylines(image, [path.astype(np.int32)], False, 98, 1, cv2.LINE_AA)
    dead_leaves(image, scale, rng, 220, (0.012, 0.05), (70, 215))
    add_noise(image, rng, 11, 0.95)


def timber(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Grey, split, knotty wood."""
    image[:] = 135
    grain(image, rng, 26, vertical=False)
    dead_leaves(image, scale, rng, 28, (0.015, 0.06), (45, 195))
    motifs.cracks(image, scale, rng, 8)
    add_noise(image, rng, 7, 0.95)


def barn(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Boarded walls with doors and windows, the roof's sheets in the upper part."""
    height, width = image.shape
    roof_high = round(0.36 * height)
    courses(image[roof_high:], scale, rng, (0.2, 30.0), 0.0, 14)
    grain(image[roof_high:], rng, 12, vertical=True)
    for _ in range(int(rng.integers(4, 9))):
        size = (rng.uniform(0.7, 1.3), rng.uniform(0.6, 1.2))
        x, y = rng.uniform(0.3, width / scale - 2), rng.uniform(0.72, 0.8) * height / scale
        pane = motifs.crop(image, scale, x, y, size)
        if min(pane.shape) >= 8:
            pane[:] = int(rng.integers(25, 70))
            motifs.frame(pane, 0.05 * scale, 205)
    gate = motifs.crop(image, scale, rng.uniform(1, 4), height / scale - 2.9, (2.8, 2.9))
    if min(gate.shape) >= 16:
        gate[:] = int(rng.integers(50, 95))
        motifs.frame(gate, 0.07 * scale, 190)
        cv2.line(gate, (0, 0), gate.shape[::-1], 180, max(1, round(0.08 * scale)), cv2.LINE_AA)
    courses(image[:roof_high], scale, rng, (0.6, 0.35), 0.5, 16)
    shade(image[:roof_high], 0.8)
    motifs.stains(image, scale, rng, 0.5)
    dead_leaves(image, scale, rng, 3, (0.03, 0.2), (50, 190))
    add_noise(image, rng, 8, 0.9)


def woods(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Crowns before crowns, lit from above, dark between them, with leaves."""
    height, width = image.shape
    image[:] = 52
    count = round(1.1 * height * width / scale**2)
    spots = rng.random((count, 2)) * (width, height)
    for (x, y), reach, tone in zip(
        spots[np.argsort(spots[:, 1])], rng.uniform(0.5, 1.5, count), rng.integers(60, 96, count), strict=True
    ):
        for share, up, lift in ((1.0, 0.0, -22), (0.78, 0.2, 0), (0.45, 0.42, 20)):
            radius = max(1, round(share * reach * scale))
            centre = (round(x), round(y - up * reach * scale))
            cv2.circle(image, centre, radius, int(tone) + lift, -1)
    leaves = np.empty_like(image)
    blotches(leaves, rng, max(2.0, 0.3 * scale), (88, 168))
    cv2.multiply(image, leaves, dst=image, scale=1 / 128, dtype=cv2.CV_8U)
    dead_leaves(image, scale, rng, 1.2, (0.08, 0.35), (30, 150))
    add_noise(image, rng, 9, 0.9)


def far_hills(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Fields and woods in the distance, pale with air."""
    blotches(image, rng, max(2.0, 1.1 * scale), (138, 168))
    dead_leaves(image, scale, rng, 1.0, (0.2, 1.2), (112, 172))
    image[:] = cv2.GaussianBlur(image, (0, 0), 2.0)


def overcast(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A closed cover of cloud, a little brighter above."""
    del scale
    height, width = image.shape
    noise = cv2.GaussianBlur(fractal_noise((height, width), rng, 0.5), (0, 0), 6.0)
    ends = np.concatenate([noise[:, : width // 2], noise[:, : width // 2][:, ::-1]], axis=1)
    noise = cv2.resize(ends, (width, height))
    above = np.linspace(204, 186, height, dtype=np.float32)[:, None]
    image[:] = np.clip(above + 7 * np.clip(noise, -2, 2), 0, 250).astype(np.uint8)
