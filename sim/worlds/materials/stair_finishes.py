"""Finishes of stairwells, and single objects on walls."""

import numpy as np

from dslab.sim.worlds.materials import motifs
from dslab.sim.worlds.materials.textures import add_noise, courses, dead_leaves, grain

STEP_M = 0.45  # metres of a flight's sheet per step: its tread above, its riser below
_NOSING_M = 0.045
_RESOLVED_PX = 0.6


def bare_plaster(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Plaster with patches, cracks and scuffs, nothing on it."""
    image[:] = 150
    add_noise(image, rng, 14, 0.6)
    motifs.stains(image, scale, rng, 1.6)
    motifs.cracks(image, scale, rng, max(1, round(2 * image.size / scale**2)))
    _scuffed(image, scale, rng)


def bare_brick(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Brickwork with nothing on it."""
    courses(image, scale, rng, (0.24, 0.08), 0.5, 30)
    _scuffed(image, scale, rng)


def bare_concrete(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Board-marked concrete with nothing on it."""
    courses(image, scale, rng, (1.1, 0.19), 0.37, 16)
    add_noise(image, rng, 14, 0.6)
    motifs.cracks(image, scale, rng, max(1, round(image.size / scale**2)))
    _scuffed(image, scale, rng)


def _scuffed(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    dead_leaves(image, scale, rng, 35, (0.004, 0.04), smallest_px=_RESOLVED_PX)
    if rng.random() < 0.35:
        motifs.cables(image, scale, rng)
    add_noise(image, rng, 15, 0.8)


def steps(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Terrazzo steps, trodden in the middle, with a dark nosing on every tread."""
    height, width = image.shape
    image[:] = 135
    dead_leaves(image, scale, rng, 260, (0.006, 0.04), smallest_px=_RESOLVED_PX)
    add_noise(image, rng, 15, 0.75)
    pitch = STEP_M * scale
    across = np.abs(np.linspace(-1.0, 1.0, width))
    worn = (0.85 + 0.2 * across)[None]
    for k in range(max(1, round(height / pitch))):
        # From below: the riser, then the tread, whose nosing is at its lower edge.
        foot = height - round(k * pitch)
        edge, top = foot - round(0.37 * pitch), foot - round(pitch)
        riser = image[max(0, edge) : foot]
        riser[:] = (riser * rng.uniform(0.68, 0.84)).astype(np.uint8)
        nosing = image[max(0, edge - round(_NOSING_M * scale)) : max(0, edge)]
        nosing[:] = (nosing * 0.3 + rng.uniform(8, 26)).astype(np.uint8)
        tread = image[max(0, top) : max(0, edge)]
        tread[:] = np.clip(tread * worn * rng.uniform(0.92, 1.1), 0, 255).astype(np.uint8)
    motifs.stains(image, scale, rng, 1.0)


def frame(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Painted wood: door frames, edges, covers."""
    image[:] = int(rng.integers(120, 190))
    grain(image, rng, 14, vertical=True)
    dead_leaves(image, scale, rng, 80, (0.004, 0.025), smallest_px=_RESOLVED_PX)
    add_noise(image, rng, 8, 0.8)


def radiator(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Ribs with dark gaps, a valve at one end, chipped paint."""
    height, width = image.shape
    image[:] = int(rng.integers(165, 205))
    pitch = max(4, round(rng.uniform(0.05, 0.075) * scale))
    for x in range(pitch, width - 1, pitch):
        image[round(0.06 * height) : round(0.94 * height), x : x + max(1, pitch // 4)] = 50
    motifs.crop(image, scale, 0.02, 0.8 * height / scale, (0.07, 0.06))[:] = 25
    dead_leaves(image, scale, rng, 120, (0.004, 0.03), smallest_px=_RESOLVED_PX)
    motifs.frame(image, 0.006 * scale, 80)
    add_noise(image, rng, 9, 0.8)


def banister(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Dark painted steel with chips."""
    image[:] = 62
    dead_leaves(image, scale, rng, 220, (0.004, 0.03), smallest_px=_RESOLVED_PX)
    add_noise(image, rng, 14, 0.85)
