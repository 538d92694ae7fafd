"""Colours of a recording, the same in every view."""

import numpy as np

Color = tuple[int, int, int]

TRUTH: Color = (210, 210, 210)
TRACKED: Color = (60, 179, 113)
INITIALISING: Color = (224, 160, 48)
LOST: Color = (224, 64, 64)
RELOCALIZING: Color = (200, 110, 110)
RECOVERED: Color = (80, 235, 90)
RECOVERY: Color = (90, 200, 220)
FUSED: Color = TRACKED
INJECTED: Color = (165, 120, 230)
REFUSED: Color = (230, 120, 40)
NOTE: Color = (130, 130, 160)

FEATURE: Color = (110, 130, 160)
INLIER: Color = (80, 230, 90)
WINDOW: Color = (255, 255, 255)

STATES = {
    "tracking": TRACKED,
    "not_initialized": INITIALISING,
    "lost": LOST,
    "relocalizing": RELOCALIZING,
}

PLAIN: Color = (200, 200, 200)

_MAPS: tuple[Color, ...] = (
    (31, 160, 255),
    (255, 150, 40),
    (200, 110, 255),
    (240, 220, 60),
    (120, 220, 220),
    (220, 90, 160),
)
_SYSTEMS: tuple[Color, ...] = ((217, 98, 43), (240, 220, 60), (120, 220, 120), (31, 160, 255))

KEY: dict[str, Color] = {
    "true path": TRUTH,
    "map 0, aligned to truth": _MAPS[0],
    "map 1, dashed: not joined": _MAPS[1],
    "placed by recovery": RECOVERED,
    "lost, no pose": LOST,
    "tracked, repaired": TRACKED,
    "initialising": INITIALISING,
    "recovery at work": RECOVERY,
    "injected stress": INJECTED,
}
"""Meaning of the main colours."""

MOST_RESIDUAL = 20.0
"""Residual of a direct system, of 255, from which on it is drawn in the last colour."""
_RESIDUALS = (INLIER, (240, 220, 60), LOST)

DIRECT_KEY: dict[str, Color] = {
    "keyframes of the window": WINDOW,
    "residual 0": _RESIDUALS[0],
    f"residual {MOST_RESIDUAL / 2:.0f} of 255": _RESIDUALS[1],
    f"residual {MOST_RESIDUAL:.0f} or more": _RESIDUALS[2],
}
"""Meaning of the colours of systems that compare intensities."""


def residual_colors(residual: np.ndarray) -> np.ndarray:
    """(n, 3) uint8 colours of (n,) residuals, whichever their sign."""
    share = np.clip(np.abs(residual) / MOST_RESIDUAL, 0, 1)
    ramp = np.array(_RESIDUALS, float).T
    steps = np.linspace(0, 1, len(_RESIDUALS))
    return np.column_stack([np.interp(share, steps, channel) for channel in ramp]).astype(np.uint8)


def map_color(map_id: int) -> Color:
    """Colour of the points, keyframes and path of a map."""
    return _MAPS[map_id % len(_MAPS)]


def system_color(index: int) -> Color:
    """Colour of a system's curves in a shared plot."""
    return _SYSTEMS[index % len(_SYSTEMS)]


def rgba(color: Color) -> int:
    """Opaque colour as 0xRRGGBBAA."""
    return color[0] << 24 | color[1] << 16 | color[2] << 8 | 255
