"""House fronts: storeys of windows with reflections, curtains and sills, shops, doors, balconies and wear."""

from dataclasses import dataclass

import cv2
import numpy as np

from dslab.sim.worlds.materials import motifs
from dslab.sim.worlds.materials.textures import add_noise, courses, dead_leaves, shade

_GROUND_FLOOR_M, _STOREY_M = 3.9, 3.1
_SMALLEST_LEAF_PX = 10


@dataclass(frozen=True)
class _Style:
    """Common style of a house's windows; lengths in metres, tones in gray levels."""

    window_m: tuple[float, float]
    frame: int
    trim: int
    bars: int
    shutters: bool
    balconies: bool


def plaster_front(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A rendered front, lighter or darker from house to house."""
    image[:] = int(rng.integers(125, 195))
    add_noise(image, rng, 5, 0.6)
    motifs.stains(image, scale, rng, 0.02)
    _front(image, scale, rng)


def brick_front(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A brick front."""
    base = int(rng.integers(-25, 25))
    courses(image, scale, rng, (0.25, 0.12), 0.5, 12)
    cv2.add(image, np.full(image.shape, float(base)), dst=image, dtype=cv2.CV_8U)
    _front(image, scale, rng)


def stone_front(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Dressed stone in large courses."""
    courses(image, scale, rng, (0.9, 0.4), 0.5, 9)
    add_noise(image, rng, 6, 0.7)
    _front(image, scale, rng)


def gable(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """The blind sides of a house with its roof: plaster, damp, few windows, tiles."""
    height, width = image.shape
    image[:] = int(rng.integers(110, 170))
    add_noise(image, rng, 9, 0.7)
    motifs.stains(image, scale, rng, 0.05)
    style = _Style((0.7, 1.0), 200, 150, 1, False, False)
    for _ in range(int(rng.integers(0, 6))):
        x, y = rng.uniform(0.1, 0.9) * width / scale, rng.uniform(0.35, 0.8) * height / scale
        _window(image, scale, rng, (x, y), style)
    roof = image[: max(2, height // 4)]
    courses(roof, scale, rng, (0.25, 0.3), 0.5, 13)
    shade(roof, 0.62)
    add_noise(image, rng, 5, 0.9)


def _front(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """Everything on a front, from the cornice down."""
    height, width = image.shape[0] / scale, image.shape[1] / scale
    style = _Style(
        window_m=(rng.uniform(0.85, 1.5), rng.uniform(1.3, 1.9)),
        frame=int(rng.choice([60, 190, 215, 230])),
        trim=int(rng.choice([90, 175, 205, 220])),
        bars=int(rng.integers(0, 3)),
        shutters=bool(rng.random() < 0.25),
        balconies=bool(rng.random() < 0.4),
    )
    _fade_down(image, rng)
    columns = max(1, int(width / (style.window_m[0] + rng.uniform(0.9, 1.6))))
    storeys = max(0, int((height - _GROUND_FLOOR_M - 0.5) / _STOREY_M))
    proud = rng.random(columns) < 0.35
    for storey in range(storeys):
        y = height - _GROUND_FLOOR_M - (storey + 1) * _STOREY_M + rng.uniform(0.45, 0.5)
        for column in range(columns):
            centre = (column + 0.5) * width / columns
            _window(image, scale, rng, (centre - style.window_m[0] / 2, y), style)
            if style.balconies and proud[column]:
                _balcony(image, scale, rng, centre, y + style.window_m[1])
        if rng.random() < 0.4:
            _band(image, scale, y + style.window_m[1] + 0.55, 0.14, style.trim)
    _ground_floor(image, scale, rng, style)
    _band(image, scale, 0.0, rng.uniform(0.25, 0.5), style.trim)
    _pipes(image, scale, rng)
    dead_leaves(image, scale, rng, 0.5, (0.02, 0.12), (70, 190))
    add_noise(image, rng, 4, 0.95)


def _fade_down(image: np.ndarray, rng: np.random.Generator) -> None:
    """Dirt that grows towards the pavement, in streaks."""
    height, width = image.shape
    streaks = cv2.resize(
        rng.uniform(0.86, 1.05, (2, max(2, width // 12))).astype(np.float32), (width, height)
    )
    streaks *= np.linspace(1.06, 0.86, height, dtype=np.float32)[:, None]
    cv2.multiply(image, streaks, dst=image, dtype=cv2.CV_8U)


def _cut(
    image: np.ndarray, scale: float, corner_m: tuple[float, float], size_m: tuple[float, float]
) -> np.ndarray:
    return motifs.crop(image, scale, corner_m[0], corner_m[1], size_m)


def _band(image: np.ndarray, scale: float, y_m: float, high_m: float, tone: int) -> None:
    """A moulding with its shadow."""
    width = image.shape[1] / scale
    shade(_cut(image, scale, (0.0, y_m + high_m), (width, 0.18)), 0.6)
    _cut(image, scale, (0.0, y_m), (width, high_m))[:] = tone
    _cut(image, scale, (0.0, y_m + 0.6 * high_m), (width, 0.05))[:] = int(0.75 * tone)


def _window(
    image: np.ndarray, scale: float, rng: np.random.Generator, corner_m: tuple[float, float], style: _Style
) -> None:
    """One window in its reveal, with shutters, sill and the shadow below it."""
    (x, y), (wide, high) = corner_m, style.window_m
    if style.shutters:
        for left in (x - 0.5 * wide, x + wide):
            leaf = _cut(image, scale, (left, y), (0.5 * wide, high))
            leaf[:] = style.trim // 2
            leaf[:: max(2, round(0.09 * scale))] = style.trim // 3
    _cut(image, scale, (x - 0.12, y - 0.12), (wide + 0.24, high + 0.2))[:] = style.trim
    reveal = _cut(image, scale, (x, y), (wide, high))
    if min(reveal.shape) < 6:
        return
    _glass(reveal, scale, rng, style)
    shade(reveal[: max(1, round(0.12 * scale))], 0.45)
    shade(_cut(image, scale, (x - 0.1, y + high + 0.1), (wide + 0.25, rng.uniform(0.15, 0.5))), 0.75)
    _cut(image, scale, (x - 0.15, y + high), (wide + 0.3, 0.1))[:] = min(245, style.trim + 20)


def _glass(pane: np.ndarray, scale: float, rng: np.random.Generator, style: _Style) -> None:
    """Glass: dark rooms, reflections of sky and houses, curtains, blinds, frame, bars."""
    height, width = pane.shape
    top, bottom = rng.uniform(50, 150), rng.uniform(18, 55)
    pane[:] = np.linspace(top, bottom, height).astype(np.uint8)[:, None]
    skyline = int(height * rng.uniform(0.3, 0.9))
    pane[skyline:, int(width * rng.uniform(0, 0.6)) :] = int(bottom)
    kind = rng.random()
    if kind < 0.35:
        hem = max(1, int(width * rng.uniform(0.12, 0.3)))
        for curtain in (pane[:, :hem], pane[:, -hem:]):
            curtain[:] = int(rng.integers(120, 205))
            curtain[:, :: max(2, round(0.1 * scale))] = 95
    elif kind < 0.6:
        blind = pane[: int(height * rng.uniform(0.2, 0.95))]
        blind[:] = int(rng.integers(140, 215))
        blind[:: max(2, round(0.12 * scale))] = 110
    elif kind < 0.7:
        sill = pane[int(0.75 * height) :]
        dead_leaves(sill, scale, rng, 30, (0.05, 0.15), (60, 190))
    rim = max(1, round(0.06 * scale))
    for column in np.linspace(0, width, style.bars + 2)[1:-1].astype(int):
        pane[:, column : column + rim] = style.frame
    pane[int(0.3 * height) : int(0.3 * height) + rim] = style.frame
    pane[:rim] = pane[-rim:] = pane[:, :rim] = pane[:, -rim:] = style.frame


def _balcony(image: np.ndarray, scale: float, rng: np.random.Generator, x_m: float, y_m: float) -> None:
    """A slab with its shadow and a railing in front of the window."""
    wide = rng.uniform(1.7, 2.3)
    left = x_m - wide / 2
    shade(_cut(image, scale, (left + 0.1, y_m + 0.15), (wide, 0.6)), 0.5)
    _cut(image, scale, (left, y_m), (wide, 0.17))[:] = int(rng.integers(170, 225))
    railing = _cut(image, scale, (left, y_m - 0.95), (wide, 0.95))
    if min(railing.shape) < 6:
        return
    tone = int(rng.choice([25, 35, 60, 210]))
    pitch = max(3, round(0.13 * scale))
    railing[:, ::pitch] = tone
    railing[: max(1, round(0.06 * scale))] = tone
    plant = railing[railing.shape[0] // 3 :, : railing.shape[1] // 2]
    if rng.random() < 0.5:
        dead_leaves(plant, scale, rng, 25, (0.05, 0.2), (30, 110))


def _ground_floor(image: np.ndarray, scale: float, rng: np.random.Generator, style: _Style) -> None:
    """Shops, doors, gates and windows side by side above a plinth."""
    height, width = image.shape[0] / scale, image.shape[1] / scale
    top = height - _GROUND_FLOOR_M
    if rng.random() < 0.6:
        _cut(image, scale, (0.0, top), (width, _GROUND_FLOOR_M))[:] = int(rng.integers(75, 190))
        add_noise(_cut(image, scale, (0.0, max(0.0, top)), (width, _GROUND_FLOOR_M)), rng, 6, 0.8)
    _cut(image, scale, (0.0, height - 0.5), (width, 0.5))[:] = int(rng.integers(60, 110))
    at = rng.uniform(0.3, 0.8)
    while at < width - 1.2:
        kind = rng.random()
        if kind < 0.4:
            wide = min(rng.uniform(2.5, 4.8), width - at - 0.2)
            _shop(image, scale, rng, (at, top + 0.25), wide)
        elif kind < 0.7:
            wide = rng.uniform(1.0, 1.4)
            _door(_cut(image, scale, (at, height - 2.6), (wide, 2.6)), scale, rng)
            _cut(image, scale, (at + wide + 0.1, height - 1.7), (0.2, 0.3))[:] = int(rng.integers(190, 240))
        elif kind < 0.8 and width - at > 3.2:
            wide = 2.7
            _gate(_cut(image, scale, (at, height - 2.7), (wide, 2.7)), scale, rng)
        else:
            wide = style.window_m[0]
            _window(image, scale, rng, (at, height - 2.9), style)
        at += wide + rng.uniform(0.3, 1.1)


def _shop(
    image: np.ndarray, scale: float, rng: np.random.Generator, corner_m: tuple[float, float], wide_m: float
) -> None:
    """A sign over display windows and a glazed door."""
    x, y = corner_m
    board, ink = ((int(rng.integers(20, 90)), 235), (int(rng.integers(180, 240)), 25))[int(rng.integers(2))]
    sign = _cut(image, scale, (x, y), (wide_m, 0.65))
    sign[:] = board
    if min(sign.shape) >= 10:
        motifs.lettering(sign, rng, int(rng.integers(4, 10)), ink)
    glass = _cut(image, scale, (x, y + 0.75), (wide_m, 2.4))
    if min(glass.shape) < 10:
        return
    glass[:] = np.linspace(95, 35, glass.shape[0]).astype(np.uint8)[:, None]
    dead_leaves(glass[glass.shape[0] // 3 :], scale, rng, 3, (0.1, 0.6), (15, 190))
    for _ in range(int(rng.integers(0, 4))):
        size = (rng.uniform(0.3, 0.7), rng.uniform(0.4, 0.9))
        sheet = _cut(glass, scale, (rng.uniform(0, max(0.1, wide_m - 1)), rng.uniform(0.4, 1.2)), size)
        if min(sheet.shape) >= 16:
            motifs.poster(sheet, scale, rng)
    rim = max(1, round(0.07 * scale))
    for column in np.linspace(0, glass.shape[1] - rim, max(2, round(wide_m / 1.4)) + 1).astype(int):
        glass[:, column : column + rim] = int(rng.choice([30, 190]))
    if rng.random() < 0.4:
        awning = _cut(image, scale, (x - 0.1, y + 0.6), (wide_m + 0.2, rng.uniform(0.5, 0.9)))
        awning[:] = int(rng.integers(60, 220))
        awning[:, : awning.shape[1]][:, :: max(4, round(0.5 * scale))] = int(rng.integers(60, 220))
        shade(_cut(image, scale, (x, y + 1.3), (wide_m, 0.5)), 0.5)


def _door(leaf: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    if min(leaf.shape) < _SMALLEST_LEAF_PX:
        return
    leaf[:] = int(rng.integers(30, 140))
    height, width = leaf.shape
    light = leaf[: height // 5, width // 8 : -(width // 8) or None]
    light[:] = int(rng.integers(30, 160))
    for top in (0.28, 0.62):
        panel = leaf[int(top * height) : int((top + 0.28) * height), width // 6 : -(width // 6) or None]
        motifs.frame(panel, 0.02 * scale, int(rng.integers(15, 60)))
    motifs.frame(leaf, 0.05 * scale, int(rng.integers(140, 230)))


def _gate(leaf: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A roller door, sometimes with graffiti."""
    if min(leaf.shape) < _SMALLEST_LEAF_PX:
        return
    leaf[:] = int(rng.integers(90, 190))
    leaf[:: max(2, round(0.14 * scale))] = 70
    if rng.random() < 0.6:
        motifs.lettering(leaf[leaf.shape[0] // 3 :], rng, int(rng.integers(3, 7)), int(rng.choice([25, 235])))
    shade(leaf[: max(1, round(0.2 * scale))], 0.4)


def _pipes(image: np.ndarray, scale: float, rng: np.random.Generator) -> None:
    """A downpipe near an edge with its shadow and brackets."""
    height, width = image.shape
    x, thick = int(width * rng.choice([0.02, 0.97])), max(1, round(0.1 * scale))
    shade(image[:, x + thick : x + 2 * thick], 0.65)
    image[:, x : x + thick] = int(rng.choice([70, 110, 180]))
    for y in range(0, height, max(4, round(1.8 * scale))):
        image[y : y + thick, max(0, x - thick) : x + 2 * thick] = 60
