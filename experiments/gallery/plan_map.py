"""The path from above, as SVG over the outline of the world."""

import math
from itertools import pairwise

import cv2
import numpy as np

from experiments.gallery.markup import Element, el, points
from experiments.gallery.sheet import Sheet
from scenarios.describe import describe_kind, measured
from sim.worlds.geometry.route import arc_length

LEVEL_M = 1.0
"""Below this climb a path counts as level."""

_LOW, _HIGH = np.array([38, 110, 214]), np.array([230, 120, 20])
_HEIGHT_STEPS = 8
_SHORTEST_BAR, _ARROWS, _GAZE = 60.0, 6, 15.0
_SIMPLER_BY = 0.3


def plan_map(sheet: Sheet) -> Element:
    """The map: start, end, direction, segments, numbered frames with the camera's gaze, a scale."""
    frame, track = sheet.map_frame, sheet.track
    path = frame.place(track.position_m[:, :2])
    return el(
        "svg",
        el("title", _in_words(sheet)),
        el(
            "image",
            href=sheet.outline_file,
            width=f"{frame.width_px:.0f}",
            height=f"{frame.height_px:.0f}",
            preserveAspectRatio="none",
        ),
        *_segments(sheet),
        *(_by_height(path, track.position_m[:, 2]) if track.climb_m > LEVEL_M else [_line(path)]),
        *_arrows(path),
        *_frames(sheet),
        *_ends(path),
        *_scale_bar(frame.px_per_m, frame.height_px),
        class_="map",
        role="img",
        viewBox=f"0 0 {frame.width_px:.0f} {frame.height_px:.0f}",
    )


def height_colour(share: float) -> str:
    """Colour of a height, 0 for the lowest of a path and 1 for the highest."""
    red, green, blue = np.rint(_LOW + share * (_HIGH - _LOW)).astype(int)
    return f"#{red:02x}{green:02x}{blue:02x}"


def _in_words(sheet: Sheet) -> str:
    kinds = [describe_kind(segment.kind) for segment in sheet.scenario.segments]
    marked = f", with the segments {', '.join(kinds)}" if kinds else ""
    return f"Path of {sheet.scenario.name} from above, {measured(sheet.track.length_m)} m{marked}"


def _line(path: np.ndarray) -> Element:
    return el("polyline", points=points(_simpler(path)), class_="path")


def _simpler(path: np.ndarray) -> np.ndarray:
    return cv2.approxPolyDP(path.astype(np.float32)[:, None], _SIMPLER_BY, False)[:, 0]


def _by_height(path: np.ndarray, height_m: np.ndarray) -> list[Element]:
    """The path in pieces of one colour each."""
    share = (height_m - height_m.min()) / np.ptp(height_m)
    step = np.minimum((share * _HEIGHT_STEPS).astype(int), _HEIGHT_STEPS - 1)
    bounds = [0, *(np.flatnonzero(np.diff(step)) + 1).tolist(), len(path) - 1]
    return [
        el(
            "polyline",
            points=points(_simpler(path[first : last + 1])),
            class_="path",
            style=f"stroke:{height_colour(step[first] / (_HEIGHT_STEPS - 1))}",
        )
        for first, last in pairwise(bounds)
        if last > first
    ]


def _segments(sheet: Sheet) -> list[Element]:
    pairs = zip(sheet.scenario.segments, sheet.track.segments_m, strict=True)
    return [
        el(
            "polyline",
            el("title", describe_kind(segment.kind)),
            points=points(sheet.map_frame.place(path_m[:, :2])),
            class_=f"segment {segment.kind}",
        )
        for segment, path_m in pairs
    ]


def _arrows(path: np.ndarray) -> list[Element]:
    """Heads along the path, evenly by its length on the map."""
    along = arc_length(path)
    heads = []
    for reached in along[-1] * (np.arange(_ARROWS) + 0.5) / _ARROWS:
        at = min(int(np.searchsorted(along, reached)), len(path) - 2)
        dx, dy = path[at + 1] - path[max(at - 1, 0)]
        turn = (
            f"translate({path[at, 0]:.1f} {path[at, 1]:.1f}) rotate({math.degrees(math.atan2(dy, dx)):.0f})"
        )
        heads.append(el("path", d="M-4 -4L5 0L-4 4z", transform=turn, class_="arrow"))
    return heads


def _frames(sheet: Sheet) -> list[Element]:
    found = []
    for number, thumb in enumerate(sheet.thumbs, 1):
        x, y = sheet.map_frame.place(thumb.position_m[:2])
        to_x, to_y = x + _GAZE * thumb.gaze[0], y - _GAZE * thumb.gaze[1]
        found += [
            el("line", x1=f"{x:.1f}", y1=f"{y:.1f}", x2=f"{to_x:.1f}", y2=f"{to_y:.1f}", class_="gaze"),
            el("circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r="2.6", class_="frame"),
            # Behind the camera, out of the gaze's way.
            el(
                "text",
                str(number),
                x=f"{x - 9 * thumb.gaze[0]:.1f}",
                y=f"{y + 9 * thumb.gaze[1] + 3.5:.1f}",
                class_="number",
            ),
        ]
    return found


def _ends(path: np.ndarray) -> list[Element]:
    (x, y), (end_x, end_y) = path[0], path[-1]
    return [
        el("circle", el("title", "start"), cx=f"{x:.1f}", cy=f"{y:.1f}", r="6", class_="start"),
        el(
            "rect",
            el("title", "end"),
            x=f"{end_x - 5:.1f}",
            y=f"{end_y - 5:.1f}",
            width="10",
            height="10",
            class_="end",
        ),
    ]


def _scale_bar(px_per_m: float, height_px: float) -> list[Element]:
    """A bar of 1, 2 or 5 times a power of ten metres."""
    at_least_m = _SHORTEST_BAR / px_per_m
    power = 10 ** math.floor(math.log10(at_least_m))
    length_m = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= at_least_m)
    y, end = height_px - 10, 10 + length_m * px_per_m
    return [
        el("path", d=f"M10 {y - 4:.0f}V{y:.0f}H{end:.1f}V{y - 4:.0f}", class_="scale"),
        el("text", f"{length_m:g} m", x=f"{end + 5:.1f}", y=f"{y + 1:.0f}", class_="label"),
    ]
