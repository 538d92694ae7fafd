"""The sheet of a parked car: its flank, and the strip from bumper to bumper."""

import cv2
import numpy as np

from dslab.sim.worlds.geometry.car_shapes import FLANK_M, STRIP_M, WAIST_M, WHEEL_M, Shape
from dslab.sim.worlds.materials import motifs
from dslab.sim.worlds.materials.textures import add_noise, dead_leaves

_PAINTS = (22, 30, 45, 60, 85, 120, 150, 175, 200, 222, 235)


def car(shape: Shape, image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Draw a car: its flank with windows, doors, wheels; its strip with panes, lamps, plates."""
    tone = int(rng.choice(_PAINTS))
    flank_px = round(FLANK_M / (FLANK_M + STRIP_M) * image.shape[0])
    across = image.shape[1] / shape.length_m
    _flank(image[:flank_px], shape, across, flank_px / FLANK_M, tone, rng)
    _strip(image[flank_px:], shape, tone, scale, rng)
    add_noise(image, rng, 3, 0.95)


def _body(image: np.ndarray, tone: int, contrast: float) -> None:
    """Paint that mirrors the sky above, the ground below and a dark horizon between."""
    height = image.shape[0]
    levels = np.array([1.25, 1.1, 0.75, 1.0, 0.92, 0.55])
    ramp = np.interp(np.linspace(0, 1, height), [0, 0.3, 0.48, 0.55, 0.75, 1.0], levels)
    ramp = 1 + contrast * (ramp - 1)
    image[:] = np.clip(ramp * tone + 14 * (ramp - 0.8), 4, 248).astype(np.uint8)[:, None]


def _flank(
    image: np.ndarray, shape: Shape, across: float, upright: float, tone: int, rng: np.random.Generator
) -> None:
    def at(x_m: float, z_m: float) -> tuple[int, int]:
        return int(x_m * across), int((FLANK_M - z_m) * upright)

    waist, sill = at(0, WAIST_M)[1], at(0, 0.2)[1]
    image[:] = tone
    _body(image[waist:sill], tone, 1.0)
    image[sill:] = 18
    glass = np.array([at(x, z) for x, z in shape.glass])
    shade = np.full_like(image, 0)
    cv2.fillPoly(shade, [glass.astype(np.int32)], 255)
    reflection = np.linspace(120, 30, max(1, waist))[:, None] * rng.uniform(0.5, 1.1)
    pane = np.zeros(image.shape)
    pane[:waist] = np.clip(reflection, 12, 190)
    image[shade > 0] = pane[shade > 0].astype(np.uint8)
    line = max(1, round(0.02 * across))
    cv2.polylines(image, [glass.astype(np.int32)], True, 15, line, cv2.LINE_AA)
    for x in shape.pillars:
        cv2.line(image, at(x, 0.28), at(x, WAIST_M), max(8, tone // 2), line)
        cv2.line(image, at(x, WAIST_M), at(x, 1.9), max(10, tone // 2), 3 * line)
        left, right = at(x - 0.3, 0.86), at(x - 0.12, 0.83)
        cv2.rectangle(image, left, right, 20 if tone > 90 else 170, -1)
    cv2.line(image, at(0, 0.55), at(shape.length_m, 0.55), max(5, int(0.6 * tone)), line)
    for x, level in ((0.12, 60), (shape.length_m - 0.22, 235)):
        cv2.ellipse(image, at(x, 0.72), (round(0.12 * across), round(0.08 * upright)), 0, 0, 360, level, -1)
    for x in shape.axles:
        _wheel(image, at(x, WHEEL_M), WHEEL_M * across, rng)


def _wheel(image: np.ndarray, centre: tuple[int, int], radius_px: float, rng: np.random.Generator) -> None:
    """A dark arch, a tyre and a rim with spokes."""
    cv2.circle(image, centre, max(2, round(1.2 * radius_px)), 12, -1)
    cv2.circle(image, centre, max(2, round(0.98 * radius_px)), 34, -1)
    cv2.circle(image, centre, max(1, round(0.66 * radius_px)), int(rng.integers(110, 190)), -1)
    spokes, phase = int(rng.integers(5, 11)), rng.uniform(0, 2 * np.pi)
    for angle in phase + 2 * np.pi * np.arange(spokes) / spokes:
        tip = np.array(centre) + 0.6 * radius_px * np.array([np.cos(angle), np.sin(angle)])
        cv2.line(image, centre, tuple(np.rint(tip).astype(int).tolist()), 45, max(1, round(0.1 * radius_px)))
    cv2.circle(image, centre, max(1, round(0.15 * radius_px)), 80, -1)


def _strip(image: np.ndarray, shape: Shape, tone: int, scale: float, rng: np.random.Generator) -> None:
    """Rear, boot, rear window, roof, windscreen, bonnet and front, left to right along the outline."""
    height, width = image.shape
    image[:] = min(248, int(1.12 * tone) + 18)
    shares = shape.shares()
    for (first, last), slope in zip(shape.panes, (70, 95), strict=True):
        pane = image[height // 12 : -(height // 12), int(shares[first] * width) : int(shares[last] * width)]
        if pane.size:
            pane[:] = np.linspace(slope, 35, pane.shape[1]).astype(np.uint8)[None]
            dead_leaves(pane, scale, rng, 2.5, (0.06, 0.3), (25, 110))
            motifs.frame(pane, 1, 15)
    rear, front = image[:, : int(shares[2] * width)], image[:, int(shares[-3] * width) :]
    for end, lamp in ((rear, 70), (front, 238)):
        end[:] = max(8, int(0.8 * tone))
        depth = end.shape[1]
        for corner in (end[: height // 5], end[-(height // 5) :]):
            corner[:, depth // 4 : 3 * depth // 4] = lamp
        plate = end[int(0.36 * height) : int(0.64 * height), depth // 3 : 2 * depth // 3]
        plate[:] = 228
        # The strip is seen turned by a right angle, so the letters run down the sheet.
        if min(plate.shape) >= 6:
            text = np.full(plate.shape[::-1], 228, np.uint8)
            motifs.lettering(text, rng, 6, 20)
            plate[:] = cv2.rotate(text, cv2.ROTATE_90_CLOCKWISE)
        motifs.frame(end, 1, max(5, tone // 3))
    grille = front[height // 4 : 3 * height // 4, front.shape[1] // 12 : front.shape[1] // 4]
    grille[:] = 22
