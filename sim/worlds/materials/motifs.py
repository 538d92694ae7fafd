"""Motifs on surfaces: posters, windows, cables, books, vents, stains.

Positions and sizes are pixels inside the function and metres in its arguments; ``scale`` is pixels per metre.
"""

import cv2
import numpy as np

from dslab.sim.worlds.materials.textures import add_noise, dead_leaves, text_block

_FONTS = (
    cv2.FONT_HERSHEY_SIMPLEX,
    cv2.FONT_HERSHEY_DUPLEX,
    cv2.FONT_HERSHEY_COMPLEX,
    cv2.FONT_HERSHEY_TRIPLEX,
)
_LETTERS = list("ABCDEFGHJKLMNPRSTUVWXYZ0123456789")


def crop(image: np.ndarray, scale: float, x_m: float, y_m: float, size_m: tuple[float, float]) -> np.ndarray:
    """A view of a rectangle of the image, possibly empty."""
    x0, y0 = max(0, round(x_m * scale)), max(0, round(y_m * scale))
    return image[
        y0 : max(y0, round((y_m + size_m[1]) * scale)), x0 : max(x0, round((x_m + size_m[0]) * scale))
    ]


def frame(image: np.ndarray, width_px: float, level: int) -> None:
    """A border inside the image's edge."""
    height, width = image.shape
    cv2.rectangle(image, (0, 0), (width - 1, height - 1), level, max(1, 2 * round(width_px)))


def lettering(image: np.ndarray, rng: np.random.Generator, letters: int, ink: int) -> None:
    """Large letters and figures that fill the image's width."""
    height, width = image.shape
    text = "".join(rng.choice(_LETTERS, letters))
    font = _FONTS[rng.integers(len(_FONTS))]
    (text_width, text_height), _ = cv2.getTextSize(text, font, 1.0, 2)
    size = min(0.9 * width / text_width, 0.7 * height / text_height)
    origin = (int((width - size * text_width) / 2), int((height + size * text_height) / 2))
    cv2.putText(image, text, origin, font, size, ink, max(1, round(2.2 * size)), cv2.LINE_AA)


def picture(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """An abstract picture with a frame."""
    image[:] = rng.integers(60, 200)
    side = min(image.shape) / scale
    dead_leaves(image, scale, rng, 40 / side**2, (0.05 * side, 0.4 * side))
    add_noise(image, rng, 12)
    frame(image, 0.025 * scale, int(rng.choice([15, 40, 225])))


def poster(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A sheet with title, picture and text, dark on light or the reverse."""
    height, width = image.shape
    paper, ink = (232, 25) if rng.random() < 0.75 else (30, 225)
    image[:] = paper
    title, body = (
        image[: height // 5, width // 12 : -width // 12],
        image[3 * height // 5 :, width // 12 : -width // 12],
    )
    lettering(title, rng, int(rng.integers(4, 9)), ink)
    middle = image[height // 5 : 3 * height // 5 - height // 30, width // 12 : -width // 12]
    if middle.size:
        picture(middle, scale, rng)
    text_block(body, rng, max(2.0, 0.014 * scale), ink)
    frame(image, 1, 120)


def notice_board(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Cork with overlapping sheets of paper."""
    image[:] = 105
    add_noise(image, rng, 22, 0.95)
    width, height = image.shape[1] / scale, image.shape[0] / scale
    for _ in range(int(14 * width * height) + 4):
        size = rng.choice([(0.21, 0.3), (0.3, 0.21), (0.1, 0.1), (0.15, 0.1)])
        note = crop(
            image,
            scale,
            rng.uniform(0, max(0.01, width - size[0])),
            rng.uniform(0, max(0.01, height - size[1])),
            tuple(size),
        )
        if min(note.shape) < 8:
            continue
        note[:] = rng.integers(150, 246)
        text_block(
            note[3:-3, 3:-3], rng, max(2.0, rng.uniform(0.008, 0.03) * scale), int(rng.integers(15, 90))
        )
        frame(note, 0.5, 70)
    frame(image, 0.03 * scale, 45)


def window(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A view of houses and trees under a bright sky, behind glazing bars."""
    height, width = image.shape
    image[:] = np.linspace(240, 190, height, dtype=np.uint8)[:, None]
    x = 0
    while x < width:
        wide, top = int(width * rng.uniform(0.12, 0.4)), int(height * rng.uniform(0.2, 0.7))
        house = image[top:, x : x + wide]
        house[:] = rng.integers(70, 190)
        step = max(4, int(0.09 * scale))
        for row in range(step // 2, house.shape[0], step):
            for column in range(step // 3, house.shape[1] - step // 2, step):
                house[row : row + step // 2, column : column + step // 2] = rng.integers(10, 240)
        x += wide
    dead_leaves(image[int(0.6 * height) :], scale, rng, 260, (0.012, 0.09), (15, 150))
    add_noise(image, rng, 9)
    bar = max(2, round(0.035 * scale))
    for column in np.linspace(0, width, max(2, round(width / scale / 0.55)) + 1)[1:-1].astype(int):
        cv2.line(image, (column, 0), (column, height), 222, bar)
    row = int(height * rng.uniform(0.3, 0.45))
    cv2.line(image, (0, row), (width, row), 222, bar)
    frame(image, 0.05 * scale, 228)
    frame(image, 0.008 * scale, 60)


def whiteboard(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Handwriting, boxes and arrows on white."""
    image[:] = 222
    height, width = image.shape
    for _ in range(int(rng.integers(4, 8))):
        x, y = int(rng.uniform(0, 0.7) * width), int(rng.uniform(0.05, 0.8) * height)
        block = image[y : y + int(0.25 * height), x : x + int(rng.uniform(0.15, 0.35) * width)]
        if rng.random() < 0.5:
            text_block(block, rng, max(2.0, 0.035 * scale), int(rng.integers(20, 110)))
        else:
            path = np.array([x + 20, y + 20]) + np.cumsum(rng.normal(0, 0.04 * scale, (24, 2)), axis=0)
            cv2.polylines(image, [path.astype(np.int32)], False, int(rng.integers(20, 110)), 2)
            frame(block, 1, 40)
    frame(image, 0.025 * scale, 90)


def vent(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A grille of dark slots."""
    image[:] = rng.integers(150, 215)
    height, width = image.shape
    pitch = max(4, round(0.03 * scale))
    for row in range(pitch, height - pitch, pitch):
        cv2.line(image, (pitch, row), (width - pitch, row), 25, max(1, pitch // 2))
    frame(image, 0.008 * scale, 55)


def cables(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A conduit with clips and boxes along it, and a sagging cable."""
    height, width = image.shape
    x, thickness = int(rng.uniform(0.1, 0.9) * width), max(2, round(0.022 * scale))
    tone = int(rng.choice([45, 70, 205]))
    cv2.line(image, (x + thickness, 0), (x + thickness, height), 30, thickness)
    cv2.line(image, (x, 0), (x, height), tone, thickness)
    for _ in range(int(rng.integers(2, 5))):
        y, half = int(rng.uniform(0, 1) * height), max(3, round(rng.uniform(0.03, 0.08) * scale))
        cv2.rectangle(image, (x - half, y - half), (x + half, y + half), int(rng.integers(150, 235)), -1)
        cv2.rectangle(image, (x - half, y - half), (x + half, y + half), 40, 1)
        cv2.circle(image, (x, y), max(1, half // 3), 25, -1)
    t = np.linspace(0, 1, 24)
    left, right, sag = rng.uniform(0.05, 0.3), rng.uniform(0.05, 0.3), rng.uniform(0.02, 0.15)
    curve = (left + (right - left) * t + 4 * sag * t * (1 - t)) * height
    cv2.polylines(
        image,
        [np.column_stack([t * width, curve]).astype(np.int32)],
        False,
        28,
        max(1, thickness // 2),
        cv2.LINE_AA,
    )


def stains(image: np.ndarray, scale: float, rng: np.random.Generator, per_m2: float) -> None:
    """Splashes with ragged rims, darker or lighter than the ground."""
    height, width = image.shape
    for _ in range(rng.poisson(per_m2 * height * width / scale**2)):
        radius = scale * rng.uniform(0.02, 0.12)
        turn = np.linspace(0, 2 * np.pi, 18, endpoint=False)
        rim = radius * (1 + 0.28 * rng.standard_normal(18))
        outline = np.column_stack([rim * np.cos(turn), rim * np.sin(turn)]) + rng.random(2) * (width, height)
        cv2.fillPoly(image, [outline.astype(np.int32)], int(rng.integers(40, 215)))


def cracks(image: np.ndarray, scale: float, rng: np.random.Generator, count: int) -> None:
    """Fine dark random walks."""
    height, width = image.shape
    for _ in range(count):
        heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.5, 40))
        steps = 0.03 * scale * np.column_stack([np.cos(heading), np.sin(heading)])
        path = rng.random(2) * (width, height) + np.cumsum(steps, axis=0)
        cv2.polylines(image, [path.astype(np.int32)], False, int(rng.integers(20, 70)), 1, cv2.LINE_AA)


def books(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """One shelf of upright books of all sizes with titles on their spines and some gaps."""
    height, width = image.shape
    image[:] = 28
    x = 0
    while x < width:
        wide = max(3, round(scale * rng.uniform(0.015, 0.06)))
        if rng.random() < 0.07:
            x += 2 * wide
            continue
        tone = int(rng.integers(45, 240))
        spine = image[int(height * rng.uniform(0.02, 0.3)) :, x : x + wide - 1]
        spine[:] = tone
        ink = 235 if tone < 130 else 30
        if min(spine.shape) >= 5:
            text_block(
                spine[spine.shape[0] // 6 : -spine.shape[0] // 4, 1:-1], rng, max(2.0, 0.012 * scale), ink
            )
            band = spine.shape[0] - spine.shape[0] // 6
            spine[band : band + max(1, round(0.01 * scale))] = ink
        x += wide
