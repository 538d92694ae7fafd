"""Colours of a recording, the same in every view."""

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
_SYSTEMS: tuple[Color, ...] = ((217, 98, 43), (31, 160, 255), (120, 220, 120), (200, 110, 255))

KEY: dict[str, Color] = {
    "true path": TRUTH,
    "estimated path": _MAPS[0],
    "placed by recovery": RECOVERED,
    "lost, no pose": LOST,
    "tracked, repaired": TRACKED,
    "initialising": INITIALISING,
    "recovery at work": RECOVERY,
    "injected stress": INJECTED,
}
"""Meaning of the main colours."""


def map_color(map_id: int) -> Color:
    """Colour of the points, keyframes and path of a map."""
    return _MAPS[map_id % len(_MAPS)]


def system_color(index: int) -> Color:
    """Colour of a system's curves in a shared plot."""
    return _SYSTEMS[index % len(_SYSTEMS)]


def rgba(color: Color) -> int:
    """Opaque colour as 0xRRGGBBAA."""
    return color[0] << 24 | color[1] << 16 | color[2] << 8 | 255
