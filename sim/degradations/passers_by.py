"""Sprites of walking people, cars and vans, seen from the side and facing right."""

from collections.abc import Callable

import cv2
import numpy as np

from dslab.sim.degradations.sprites import Sprite, filled, smooth_outline

_TORSO = [
    (-0.1, 0.84),
    (-0.13, 0.95),
    (-0.11, 1.15),
    (-0.14, 1.35),
    (-0.09, 1.48),
    (0.02, 1.51),
    (0.09, 1.44),
]
_TORSO += [(0.14, 1.28), (0.1, 1.08), (0.11, 0.95), (0.1, 0.84)]
_HEAD = [(-0.06, 1.5), (-0.08, 1.62), (-0.04, 1.71), (0.05, 1.72), (0.1, 1.66), (0.1, 1.62), (0.135, 1.6)]
_HEAD += [(0.11, 1.575), (0.105, 1.53), (0.06, 1.49)]
_HAIR = [(-0.06, 1.52), (-0.1, 1.62), (-0.07, 1.72), (0.03, 1.745), (0.1, 1.71), (0.09, 1.675), (0.03, 1.68)]
_HAIR += [(0.0, 1.62), (-0.03, 1.56)]

POSES = 8
"""Number of poses of a double step."""

_MAX_PX = 256  # a sprite's height: nearer objects are out of focus
# Outlines in metres, from the rear bumper over the roof to the front one.
_CAR = [
    (0.05, 0.28),
    (0, 0.45),
    (0.02, 0.75),
    (0.12, 0.92),
    (0.35, 0.95),
    (0.8, 0.98),
    (1.25, 1.2),
    (1.6, 1.4),
]
_CAR += [(2.0, 1.46), (2.6, 1.44), (2.95, 1.32), (3.35, 1.02), (3.5, 0.97), (4.05, 0.86), (4.25, 0.76)]
_CAR += [(4.32, 0.6), (4.3, 0.35), (4.2, 0.26)]
_CAR_WINDOWS = [
    [(1.15, 1.02), (1.4, 1.18), (1.68, 1.34), (1.95, 1.37), (2.2, 1.37), (2.2, 1.2), (2.2, 1.0), (1.6, 1.0)],
    [(2.3, 1.0), (2.3, 1.2), (2.3, 1.37), (2.6, 1.37), (2.85, 1.3), (3.2, 1.04), (2.8, 1.0)],
]
_VAN = [(0.08, 0.3), (0, 0.4), (0, 0.6), (0, 2.2), (0.03, 2.38), (0.15, 2.45), (0.4, 2.46), (3.9, 2.46)]
_VAN += [(4.2, 2.43), (4.4, 2.3), (4.6, 2.05), (4.95, 1.45), (5.1, 1.32), (5.45, 1.15), (5.55, 0.95)]
_VAN += [(5.58, 0.5), (5.5, 0.3)]
_VAN_WINDOWS = [
    [(3.9, 1.4), (3.9, 1.6), (3.9, 2.1), (4.1, 2.12), (4.35, 2.1), (4.75, 1.5), (4.8, 1.4), (4.4, 1.38)]
]
PERSON_M, CAR_M, VAN_M = 1.75, 1.5, 2.5
"""Heights of the sprites, metres."""

Paint = Callable[[np.ndarray, np.ndarray], None]
"""Paints (h, w) gray levels of a cloth over an (h, w) cover."""


def person(px_per_m: float, rng: np.random.Generator) -> Sprite:
    """A walking person in random clothes, at most as large as drawn."""
    rows = int(np.clip(PERSON_M * px_per_m, 12, _MAX_PX))
    size = (rows, max(8, round(rows / 1.7)))
    px = rows / PERSON_M
    shirt, trousers, skin = (_cloth(size, px, rng, patterned) for patterned in (True, False, False))
    skin = np.full_like(skin, rng.uniform(90, 190)) + (skin - skin.mean()) * 0.15
    hair = np.full_like(skin, rng.uniform(20, 110))
    build = float(rng.uniform(0.85, 1.2))
    grays, alphas = [], []
    for phase in np.arange(POSES) * 2 * np.pi / POSES:
        gray, alpha = np.zeros(size, np.float32), np.zeros(size, np.float32)
        lay = _layer(gray, alpha)

        def limb(points: list[tuple[float, float]], width_m: float, cloth: np.ndarray, shade: float, lay=lay):
            lay(_stroke(size, px, points, width_m * build), cloth * shade)

        swing = 0.42 * np.sin(phase)
        lift = 0.25 * np.maximum(0, np.cos(phase)), 0.25 * np.maximum(0, -np.cos(phase))
        limb(_leg(-swing, lift[1]), 0.15, trousers, 0.7)
        limb(_arm(swing), 0.09, shirt, 0.7)
        limb(_leg(swing, lift[0]), 0.15, trousers, 1.0)
        lay(filled(size, _to_px(smooth_outline(np.array(_TORSO) * (build, 1)), size, px)), shirt)
        limb(_arm(-swing), 0.09, shirt, 1.12)
        limb([(0.01, 1.45), (0.03, 1.6)], 0.1 / build, skin, 0.9)
        lay(filled(size, _to_px(smooth_outline(np.array(_HEAD)), size, px)), skin)
        lay(filled(size, _to_px(smooth_outline(np.array(_HAIR)), size, px)), hair)
        grays.append(_rounded(gray, alpha, 0.05 * px))
        alphas.append(_byte(255 * alpha))
    return Sprite(np.stack(grays), np.stack(alphas))


def vehicle(px_per_m: float, is_van: bool, rng: np.random.Generator) -> Sprite:
    """A car, or a van with lettering."""
    body, windows, wheels_m, tall_m = (
        (_VAN, _VAN_WINDOWS, (1.0, 4.5), VAN_M) if is_van else (_CAR, _CAR_WINDOWS, (0.85, 3.4), CAR_M)
    )
    rows = int(np.clip(tall_m * px_per_m, 12, _MAX_PX))
    px = rows / tall_m
    size = (rows, round((max(x for x, _ in body) + 0.1) * px))
    gray, alpha = np.zeros(size, np.float32), np.zeros(size, np.float32)
    lay, middle_m = _layer(gray, alpha), size[1] / px / 2

    def outline(corners: list[tuple[float, float]]) -> np.ndarray:
        placed = np.array(corners) - (middle_m - 0.05, 0)
        return filled(size, _to_px(smooth_outline(placed), size, px))

    paint = np.full(size, rng.uniform(40, 220), np.float32)
    # Paint mirrors the sky above the waist line, the road below.
    paint *= 1 + 0.2 * np.sin(np.linspace(2.5, -2.5, size[0], dtype=np.float32))[:, None]
    if is_van:
        paint = 0.75 * paint + 0.25 * _cloth(size, px / 4, rng)
    mirrored = _cloth((size[0], max(8, size[1] // 6)), px, rng, patterned=False)
    paint += 0.5 * (cv2.resize(mirrored, size[::-1], interpolation=cv2.INTER_CUBIC) - mirrored.mean())
    paint += 3 * rng.standard_normal(size, np.float32)
    lay(outline(body), paint)
    for x in (1.5, 2.25, 3.1):
        lay(0.6 * _stroke(size, px, [(x - middle_m, 0.35), (x - middle_m, 1.0)], 0.02), 0.4 * paint)
    glass = np.clip(40 + 0.6 * cv2.GaussianBlur(_cloth(size, px, rng), (0, 0), 0.04 * px + 0.5), 0, 150)
    for window in windows:
        lay(outline(window), glass)
    for x in wheels_m:
        for radius_m, level in ((0.34, 25.0), (0.2, 150.0), (0.16, 80.0), (0.05, 170.0)):
            wheel = np.array([(x - middle_m + 0.05, 0.34)]) + radius_m * _circle()
            lay(filled(size, _to_px(wheel, size, px)), np.full(size, level, np.float32))
    return Sprite(_rounded(gray, alpha, 0.06 * px)[None], _byte(255 * alpha)[None])


def _leg(swing: float, lift: float) -> list[tuple[float, float]]:
    """Hip, knee, heel and toe, metres; a lifted leg bends its knee."""
    knee = (0.45 * np.sin(swing + lift), 0.9 - 0.43 * np.cos(swing + lift))
    low = swing - lift
    heel = (knee[0] + 0.42 * np.sin(low), max(0.05, knee[1] - 0.42 * np.cos(low)))
    return [(0.0, 0.9), knee, heel, (heel[0] + 0.1, heel[1] - 0.02)]


def _arm(swing: float) -> list[tuple[float, float]]:
    elbow = (0.28 * np.sin(swing), 1.4 - 0.28 * np.cos(swing))
    return [
        (0.0, 1.42),
        elbow,
        (elbow[0] + 0.26 * np.sin(swing + 0.4), elbow[1] - 0.26 * np.cos(swing + 0.4)),
    ]


def _circle() -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _to_px(points_m: np.ndarray, size: tuple[int, int], px: float) -> np.ndarray:
    """Pixels of points in metres, right of the sprite's middle and above the ground."""
    return np.column_stack([size[1] / 2 + points_m[:, 0] * px, size[0] - 1 - points_m[:, 1] * px])


def _stroke(
    size: tuple[int, int], px: float, points_m: list[tuple[float, float]], width_m: float
) -> np.ndarray:
    """(h, w) float32 cover of a line with round ends."""
    cover = np.zeros(size, np.uint8)
    line = np.rint(_to_px(np.array(points_m), size, px) * 16).astype(np.int32)
    cv2.polylines(cover, [line], False, 255, max(1, round(width_m * px)), cv2.LINE_AA, 4)
    return cover.astype(np.float32) / 255


def _layer(gray: np.ndarray, alpha: np.ndarray) -> Paint:
    """Return a painter of covers with their cloth, later ones on top."""

    def lay(cover: np.ndarray, cloth: np.ndarray) -> None:
        gray[:] += cover * (cloth - gray)
        np.maximum(alpha, cover, out=alpha)

    return lay


def _cloth(size: tuple[int, int], px: float, rng: np.random.Generator, patterned: bool = True) -> np.ndarray:
    """(h, w) float32 levels: a colour, folds, a weave and, if patterned, stripes, checks or a print."""
    rows, columns = np.mgrid[: size[0], : size[1]].astype(np.float32) / np.float32(px)
    cloth = np.full(size, rng.uniform(45, 190), np.float32)
    pattern = rng.integers(4) if patterned else 0
    contrast = float(rng.uniform(8, 40))
    period_m = float(rng.uniform(0.05, 0.16))
    if pattern == 1:
        cloth += contrast * np.sign(np.sin(2 * np.pi * rows / period_m))
    elif pattern == 2:
        checks = np.sign(np.sin(2 * np.pi * rows / period_m)) + np.sign(
            np.sin(2 * np.pi * columns / period_m)
        )
        cloth += contrast / 2 * checks
    elif pattern == 3:
        grid = (max(2, int(1.75 / period_m)), max(2, int(1.75 / period_m * size[1] / size[0])))
        print_ = rng.uniform(-1, 1, grid).astype(np.float32)
        cloth += contrast * cv2.resize(print_, size[::-1], interpolation=cv2.INTER_CUBIC)
    for cell_m, spread in ((0.25, 14), (0.06, 10), (0.015, 6)):
        grid = (max(2, int(size[0] / px / cell_m)), max(2, int(size[1] / px / cell_m)))
        folds = rng.standard_normal(grid).astype(np.float32)
        cloth += spread * cv2.resize(folds, size[::-1], interpolation=cv2.INTER_CUBIC)
    return cloth


def _rounded(gray: np.ndarray, alpha: np.ndarray, rim_px: float) -> np.ndarray:
    """(h, w) uint8, darker towards the outline like a round body."""
    lit = np.linspace(1.08, 0.85, gray.shape[0], dtype=np.float32)[:, None]
    inward = cv2.distanceTransform((alpha > 0.5).astype(np.uint8), cv2.DIST_L2, 3)
    shade = 0.65 + 0.35 * np.minimum(1, inward / max(1.0, rim_px))
    return _byte(gray * shade * lit)


def _byte(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
