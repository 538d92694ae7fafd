"""Ground, plants, vehicles and street furniture."""

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
)

_CLOUD_EDGE_PX = 4.0
KERB_SHARE = 0.06
"""Share of a pavement's sheet, at its lower end, that shows the upright face of the kerb."""


def asphalt(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A worn carriageway seen along its length, left to right: patches, cracks, covers, markings."""
    height, width = image.shape
    _tar(image, scale, rng)
    line = max(1, round(0.07 * scale))
    for x in np.arange(rng.uniform(0, 1), width / scale, 4.5):
        image[height // 2 - line : height // 2 + line, int(x * scale) : int((x + 2.2) * scale)] = 205
    for edge in (0.2, 0.8):
        y = int(edge * height)
        for x in np.arange(0, width / scale, 6.0):
            image[y - line : y + line, int(x * scale) : int((x + 0.9) * scale)] = 195
    if rng.random() < 0.3:
        _arrow(image, scale, rng)
    _wear_down(image, rng)


def crossing(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """The carriageway where streets meet, with stripes for walkers along its edges."""
    height, width = image.shape
    _tar(image, scale, rng)
    depth, pitch = max(2, round(2.2 * scale)), max(4, round(1.0 * scale))
    sides = rng.random(4) < 0.75
    for start in range(depth, min(height, width) - depth - pitch // 2, pitch):
        bar = slice(start, start + pitch // 2)
        if sides[0]:
            image[bar, :depth] = 200
        if sides[1]:
            image[bar, -depth:] = 200
        if sides[2]:
            image[:depth, bar] = 200
        if sides[3]:
            image[-depth:, bar] = 200
    _wear_down(image, rng)


def motorway_lanes(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Two lanes and a hard shoulder of fresh asphalt: long seams and few marks."""
    height, width = image.shape
    image[:] = 92
    add_noise(image, rng, 6, 0.65)
    dead_leaves(image, scale, rng, 0.5, (0.1, 0.6), (72, 116))
    image[int(0.56 * height) : int(0.56 * height) + 1] = 60
    line = max(1, round(0.08 * scale))
    for share, dash in ((0.06, 0.0), (0.42, 6.0), (0.77, 0.0)):
        y = int(share * height)
        for x in np.arange(0, width / scale, 3 * dash if dash else width / scale):
            end = x + (dash or width / scale)
            image[max(0, y - line) : y + line, int(x * scale) : int(end * scale)] = 205
    motifs.cracks(image, scale, rng, 2)
    add_noise(image, rng, 3, 0.7)


def paving(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Flags with gum, covers and leaves; the kerb and its face along the lower edge."""
    height = image.shape[0]
    courses(image, scale, rng, (rng.uniform(0.4, 0.8), rng.uniform(0.4, 0.6)), 0.5, 8)
    add_noise(image, rng, 7, 0.75)
    dead_leaves(image, scale, rng, 7, (0.02, 0.09), (70, 190))
    motifs.stains(image, scale, rng, 0.15)
    _covers(image, scale, rng, 0.012)
    face = max(2, round(KERB_SHARE * height))
    kerb = image[-3 * face :]
    kerb[:] = 165
    kerb[:, :: max(3, round(scale))] = 80
    image[-face:] = 95
    image[-1:] = 45
    add_noise(kerb, rng, 9, 0.8)


def meadow(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Grass in tufts, bare earth, flowers and stones."""
    # No long waves: neighbouring pieces of ground would differ in tone at their border.
    blotches(image, rng, max(2.0, 0.1 * scale), (100, 150))
    dead_leaves(image, scale, rng, 4.0, (0.03, 0.4), (60, 175))
    add_noise(image, rng, 16, 0.97)


def verge(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Mown grass beside a road: even, with few marks large enough not to alias."""
    add_noise(image, rng, 9, 0.6)
    dead_leaves(image, scale, rng, 0.5, (0.2, 1.1), (85, 155))
    image[:] = cv2.GaussianBlur(image, (0, 0), 1.0)


def metal(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Posts, rails and plates: galvanised, with rust, bolts and stickers."""
    image[:] = int(rng.integers(100, 175))
    add_noise(image, rng, 10, 0.75)
    motifs.stains(image, scale, rng, 1.5)
    dead_leaves(image, scale, rng, 30, (0.015, 0.12), (30, 220))


def rail(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A guard rail's beam, lighter on top, with joints, bolts, scrapes; its posts below."""
    height, width = image.shape
    beam = round(height * 0.62)
    rows = np.linspace(0, 2 * np.pi * 2, beam)
    image[:beam] = np.clip(140 + 16 * np.cos(rows), 0, 255).astype(np.uint8)[:, None]
    image[beam:] = 88
    for x in np.arange(rng.uniform(0, 2), width / scale, 4.0):
        at = int(x * scale)
        image[:beam, at : at + max(1, round(0.03 * scale))] = 60
        for y in (0.25, 0.75):
            for aside in (-0.08, 0.1):
                cv2.circle(
                    image, (at + round(aside * scale), round(y * beam)), max(1, round(0.03 * scale)), 52, -1
                )
    # Nothing finer than a hand: at a distance of a few posts it would vanish or alias.
    dead_leaves(image, scale, rng, 9, (0.12, 0.4), (55, 215))
    motifs.stains(image, scale, rng, 1.2)
    add_noise(image, rng, 7, 0.6)


def noise_wall(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Grooved panels in rows, damp, with creepers and sometimes a sprayed word."""
    height, width = image.shape
    courses(image, scale, rng, (4.0, 0.9), 0.0, 12)
    groove = max(3, round(0.15 * scale))
    image[::groove] = (0.8 * image[::groove]).astype(np.uint8)
    add_noise(image, rng, 9, 0.75)
    for _ in range(rng.poisson(1.0)):
        place = motifs.crop(image, scale, rng.uniform(0, 16), rng.uniform(1.2, 2.0), (3.5, 1.3))
        if min(place.shape) >= 12:
            motifs.lettering(place, rng, int(rng.integers(3, 6)), int(rng.choice([30, 215])))
    for _ in range(rng.poisson(2.0)):
        x = int(rng.uniform(0, 0.85) * width)
        dead_leaves(image[height // 3 :, x : x + width // 8], scale, rng, 25, (0.06, 0.3), (35, 110))
    motifs.stains(image, scale, rng, 0.5)


def bridge(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Concrete with the marks of its boards, streaks below the joints, patches."""
    courses(image, scale, rng, (2.4, 0.5), 0.4, 10)
    multiply(image, rng.uniform(0.75, 1.08, (2, max(2, image.shape[1] // 10))))
    add_noise(image, rng, 10, 0.75)
    motifs.stains(image, scale, rng, 0.4)
    dead_leaves(image, scale, rng, 1.5, (0.05, 0.25), (90, 190))


def sign(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A sheet for a sign: a rimmed plate with letters above, the post's metal below."""
    metal(image, scale, rng)
    plate = image[: image.shape[0] // 2]
    paper, ink = ((225, 25), (45, 230))[int(rng.integers(2))]
    plate[:] = paper
    motifs.lettering(plate, rng, int(rng.integers(2, 6)), ink)
    motifs.frame(plate, 0.03 * scale, ink)
    add_noise(plate, rng, 4)


def tree(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Leaves in light and shade; bark on the rightmost eighth."""
    width = image.shape[1]
    blotches(image, rng, max(2.0, 0.11 * scale), (20, 125))
    bark = image[:, 7 * width // 8 :].copy()
    add_noise(image, rng, 20, 0.8)
    bark[:] = 75
    grain(bark, rng, 24, vertical=True)
    dead_leaves(bark, scale, rng, 20, (0.02, 0.1), (30, 130))
    image[:, 7 * width // 8 :] = bark
    add_noise(image, rng, 7, 0.95)


def clouds(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Sky from the horizon (below) to the zenith (above), bright towards the horizon, with clouds."""
    del scale
    height, width = image.shape
    noise = cv2.GaussianBlur(fractal_noise((height, width), rng, 0.55), (0, 0), 5.0)
    # The sheet closes on itself around the horizon.
    join = max(1, width // 12)
    weight = np.linspace(0.0, 1.0, join, dtype=np.float32)
    noise[:, -join:] = (1 - weight) * noise[:, -join:] + weight * noise[:, join - 1 :: -1]
    cover = 1 / (1 + np.exp(-3.0 * (noise - 0.1)))
    blue = np.linspace(145, 176, height, dtype=np.float32)[:, None]
    lit = 192 + 5 * np.clip(noise, -2, 2)
    # Exposed for the ground, a sky is pale: too soft for corners.
    soft = cv2.GaussianBlur(blue + cover * (lit - blue), (0, 0), _CLOUD_EDGE_PX)
    image[:] = np.clip(np.rint(soft), 0, 250).astype(np.uint8)


def _tar(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    height, width = image.shape
    image[:] = 98
    for _ in range(int(rng.integers(1, 5))):
        x, y = rng.integers(0, width), rng.integers(0, height)
        size = (scale * rng.uniform((0.5, 0.4), (6.0, 2.0))).astype(int)
        tone = int(rng.integers(70, 122))
        cv2.rectangle(image, (int(x), int(y)), (int(x + size[0]), int(y + size[1])), tone, -1)
        cv2.rectangle(image, (int(x), int(y)), (int(x + size[0]), int(y + size[1])), 52, 1)
    add_noise(image, rng, 8, 0.75)
    dead_leaves(image, scale, rng, 2.0, (0.03, 0.15), (60, 135))
    motifs.stains(image, scale, rng, 0.06)
    motifs.cracks(image, scale, rng, int(rng.integers(3, 9)))
    _covers(image, scale, rng, 0.012)


def _covers(image: np.ndarray, scale: float, rng: np.random.Generator, per_m2: float) -> None:
    """Manhole covers and gullies."""
    height, width = image.shape
    for _ in range(rng.poisson(per_m2 * height * width / scale**2)):
        centre, radius = (int(rng.integers(width)), int(rng.integers(height))), max(2, round(0.3 * scale))
        if rng.random() < 0.6:
            cv2.circle(image, centre, radius, 58, -1)
            cv2.circle(image, centre, radius, 130, max(1, radius // 7))
            cv2.circle(image, centre, radius // 2, 95, max(1, radius // 7))
        else:
            corner = (centre[0] + 2 * radius, centre[1] + radius)
            cv2.rectangle(image, centre, corner, 40, -1)
            cv2.rectangle(image, centre, corner, 120, 1)


def _arrow(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A lane arrow, worn."""
    height, width = image.shape
    y, x = int(height * rng.choice([0.34, 0.66])), int(width * rng.uniform(0.2, 0.6))
    way = 1 if y > height / 2 else -1
    tip = (x + way * round(2.6 * scale), y)
    cv2.arrowedLine(image, (x, y), tip, 200, max(1, round(0.18 * scale)), tipLength=0.35)


def _wear_down(image: np.ndarray, rng: np.random.Generator) -> None:
    """Marks rubbed off here and there, tyre tracks and grit."""
    tracks = 1 + 0.05 * np.sin(np.linspace(0, 8 * np.pi, image.shape[0], dtype=np.float32))
    cv2.multiply(image, tracks[:, None].repeat(image.shape[1], axis=1), dst=image, dtype=cv2.CV_8U)
    add_noise(image, rng, 6, 0.9)
