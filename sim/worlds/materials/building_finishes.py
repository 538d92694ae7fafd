"""Walls, floors and ceilings, with the objects on them."""

import cv2
import numpy as np

from dslab.sim.worlds.materials import motifs
from dslab.sim.worlds.materials.textures import add_noise, courses, dead_leaves, grain

_SKIRTING_M, _CORNICE_M = 0.09, 0.05
_RESOLVED_PX = 0.6


def brick(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A brick wall."""
    courses(image, scale, rng, (0.24, 0.08), 0.5, 32)
    _wall_details(image, scale, rng)


def plaster(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Old plaster with patches and cracks."""
    image[:] = 150
    add_noise(image, rng, 14, 0.55)
    motifs.stains(image, scale, rng, 2.0)
    motifs.cracks(image, scale, rng, 8)
    _wall_details(image, scale, rng)


def concrete(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Board-marked concrete with tie holes and a number sprayed on."""
    courses(image, scale, rng, (1.1, 0.19), 0.37, 20)
    add_noise(image, rng, 14, 0.6)
    for x in np.arange(0.2, image.shape[1] / scale, 0.55):
        for y in np.arange(0.3, image.shape[0] / scale, 0.8):
            cv2.circle(image, (int(x * scale), int(y * scale)), max(2, round(0.018 * scale)), 25, -1)
    place = motifs.crop(image, scale, 0.1, rng.uniform(0.1, 1.5), (0.7, 0.3))
    if place.size:
        motifs.lettering(place, rng, 4, 30)
    motifs.cracks(image, scale, rng, 5)
    _wall_details(image, scale, rng)


def tiles(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Wall tiles of many tones."""
    courses(image, scale, rng, (0.15, 0.15), 0.0, 26)
    _wall_details(image, scale, rng)


def boards(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Upright wooden boards."""
    courses(image, scale, rng, (0.14, image.shape[0] / scale), 0.0, 26)
    grain(image, rng, 18, vertical=True)
    _wall_details(image, scale, rng)


def parquet(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A worn wooden floor."""
    courses(image, scale, rng, (0.45, 0.09), 0.43, 20)
    grain(image, rng, 10, vertical=False)
    motifs.stains(image, scale, rng, 1.5)
    _weather(image, scale, rng)


def stone(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Terrazzo slabs: chips of all sizes."""
    courses(image, scale, rng, (0.5, 0.5), 0.0, 12)
    dead_leaves(image, scale, rng, 220, (0.008, 0.06), smallest_px=_RESOLVED_PX)
    add_noise(image, rng, 14, 0.8)
    motifs.cracks(image, scale, rng, 3)


def ceiling(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Acoustic tiles with pinholes, vents and damp patches."""
    courses(image, scale, rng, (0.6, 0.6), 0.0, 9)
    motifs.stains(image, scale, rng, 1.2)
    dead_leaves(image, scale, rng, 150, (0.006, 0.035), (20, 130), _RESOLVED_PX)
    add_noise(image, rng, 13, 0.8)
    width, height = image.shape[1] / scale, image.shape[0] / scale
    for _ in range(int(rng.integers(0, 3))):
        place = motifs.crop(
            image, scale, rng.uniform(0, 0.7) * width, rng.uniform(0, 0.7) * height, (0.4, 0.25)
        )
        if min(place.shape) >= 16:
            motifs.vent(place, scale, rng)


def lamp(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A luminous panel with a grid and a rim."""
    image[:] = 230
    pitch = max(4, round(0.08 * scale))
    image[::pitch] = image[:, ::pitch] = 205
    add_noise(image, rng, 3)
    motifs.frame(image, 0.012 * scale, 120)


def _wall_details(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Wear, objects on the wall, and skirting and cornice that continue over every panel."""
    _weather(image, scale, rng)
    _hang_objects(image, scale, rng)
    skirting, cornice = max(2, round(_SKIRTING_M * scale)), max(2, round(_CORNICE_M * scale))
    image[-skirting:], image[:cornice] = 62, 190
    image[-skirting:][:1], image[:cornice][-1:] = 185, 70
    add_noise(image, rng, 5, 0.9)


def _weather(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Chips, specks and noise at all scales."""
    dead_leaves(image, scale, rng, 45, (0.004, 0.05), smallest_px=_RESOLVED_PX)
    add_noise(image, rng, 17, 0.8)


_LARGE = (
    motifs.poster,
    motifs.poster,
    motifs.picture,
    motifs.notice_board,
    motifs.notice_board,
    motifs.whiteboard,
    motifs.window,
    motifs.window,
)
_SMALL = (motifs.vent, motifs.picture, motifs.poster)


def _hang_objects(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Hang mostly one large object at eye height, small ones above and below, cables between."""
    width, height = image.shape[1] / scale, image.shape[0] / scale
    if rng.random() < 0.5:
        motifs.cables(image, scale, rng)
    if rng.random() < 0.8:
        draw = _LARGE[rng.integers(len(_LARGE))]
        size = (width * rng.uniform(0.4, 0.85), min(height, 2.6) * rng.uniform(0.25, 0.5))
        _place(image, scale, rng, draw, size, rng.uniform(0.14, 0.34) * height)
    for top in (rng.uniform(0.03, 0.12), rng.uniform(0.68, 0.85)):
        if rng.random() < 0.7:
            draw = _SMALL[rng.integers(len(_SMALL))]
            size = (rng.uniform(0.2, 0.45), rng.uniform(0.15, 0.3))
            _place(image, scale, rng, draw, size, top * height)


def _place(
    image: np.ndarray, scale: float, rng: np.random.Generator, draw, size_m: tuple, y_m: float
) -> None:
    """Draw a motif at a random place along the wall, unless it is too small."""
    x_m = rng.uniform(0, max(0.01, image.shape[1] / scale - size_m[0]))
    place = motifs.crop(image, scale, x_m, y_m, size_m)
    if min(place.shape) < 16:
        return
    # A soft shadow separates the motif from the wall.
    shadow = motifs.crop(image, scale, x_m - 0.015, y_m + 0.01, (size_m[0] + 0.03, size_m[1] + 0.025))
    shadow[:] = (shadow * 0.6).astype(np.uint8)
    draw(place, scale, rng)
