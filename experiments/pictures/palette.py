"""Colours of a run's picture, the same in all of its parts."""

from collections.abc import Iterable

_SYSTEMS = {
    "base": "#d9622b",
    "orbslam": "#8c4a8c",
    "dual": "#101060",
    "dual+": "#1f6fb4",
    "paper": "#8a6d1f",
    "paper+": "#2c8a6d",
    "dso": "#3a8fa0",
    "ldso": "#a03a6b",
}
_OTHER_SYSTEMS = ("#4a8a8a", "#8a6d3b", "#5b6770")
_SEGMENTS = {"low_texture": "#e8cf8a", "motion_blur": "#c9b3e6", "fast_rotation": "#a9d5c5"}
_OTHER_SEGMENTS = ("#f0b8b0", "#b9d3ee", "#d6d6c2", "#cfe3a5", "#e8c4de", "#f2d0a9", "#a8dde0", "#c8c8d8")

TRUTH = "0.72"
BREAKAGE = "#c00020"
RECOVERED = "#30b040"
HEALED = "#1b6b34"
FEATURE, INLIER = "#e0a030", "#20c060"


def system_color(name: str, place: int) -> str:
    """Colour of a system; of an unknown one by its place in the order of display."""
    return _SYSTEMS.get(name, _OTHER_SYSTEMS[place % len(_OTHER_SYSTEMS)])


def segment_colors(kinds: Iterable[str]) -> dict[str, str]:
    """Colour of each kind of segment."""
    kinds = list(dict.fromkeys(kinds))
    others = [kind for kind in kinds if kind not in _SEGMENTS]
    free = {kind: _OTHER_SEGMENTS[place % len(_OTHER_SEGMENTS)] for place, kind in enumerate(others)}
    return {kind: (_SEGMENTS | free)[kind] for kind in kinds}
