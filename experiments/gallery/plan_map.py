"""Map of a path from above, as SVG over the outline of the world."""

import math
from collections.abc import Iterator
from itertools import pairwise

import cv2
import numpy as np
from markupsafe import Markup

from dslab.experiments.gallery.sheet import Sheet
from dslab.scenarios.describe import describe_kind, measured
from dslab.sim.worlds.geometry.route import arc_length

# A path that climbs less counts as level.
_LEVEL_M = 1.0
_LOW, _HIGH = np.array([38, 110, 214]), np.array([230, 120, 20])
_HEIGHT_STEPS = 8
_SHORTEST_BAR, _ARROWS, _GAZE = 60.0, 6, 15.0
_SIMPLIFICATION = 0.3

_MAP = Markup("""\
<svg class="map" role="img" viewBox="0 0 {width:.0f} {height:.0f}">
<title>{title}</title>
<image href="{outline}" width="{width:.0f}" height="{height:.0f}" preserveAspectRatio="none"/>
{marks}
</svg>""")
_SEGMENT = Markup('<polyline points="{}" class="segment {}"><title>{}</title></polyline>')
_LINE = Markup('<polyline points="{}" class="path"{}/>')
_ARROW = Markup(
    '<path d="M-4 -4L5 0L-4 4z" transform="translate({:.1f} {:.1f}) rotate({:.0f})" class="arrow"/>'
)
_GAZE_LINE = Markup('<line x1="{:.1f}" y1="{:.1f}" x2="{:.1f}" y2="{:.1f}" class="gaze"/>')
_FRAME = Markup('<circle cx="{:.1f}" cy="{:.1f}" r="2.6" class="frame"/>')
_NUMBER = Markup('<text x="{:.1f}" y="{:.1f}" class="number">{}</text>')
_START = Markup('<circle cx="{:.1f}" cy="{:.1f}" r="6" class="start"><title>start</title></circle>')
_END = Markup('<rect x="{:.1f}" y="{:.1f}" width="10" height="10" class="end"><title>end</title></rect>')
_SCALE = Markup(
    '<path d="M10 {0:.0f}V{1:.0f}H{2:.1f}V{0:.0f}" class="scale"/>'
    '<text x="{3:.1f}" y="{4:.0f}" class="label">{5:g} m</text>'
)


def plan_map(sheet: Sheet) -> Markup:
    """Draw path, direction, segments, numbered frames with viewing directions, and a scale."""
    frame, track = sheet.map_frame, sheet.track
    path = frame.place(track.position_m[:, :2])
    marks = [
        *_segments(sheet),
        *(_by_height(path, track.position_m[:, 2]) if height_range_m(sheet) else [_line(path)]),
        *_arrows(path),
        *_frames(sheet),
        _START.format(*path[0]),
        _END.format(*(path[-1] - 5)),
        _scale_bar(frame.px_per_m, frame.height_px),
    ]
    return _MAP.format(
        title=_title(sheet),
        outline=sheet.outline_file,
        width=frame.width_px,
        height=frame.height_px,
        marks=Markup("\n").join(marks),
    )


def height_colour(share: float) -> str:
    """Colour of a relative height, 0 for the lowest and 1 for the highest."""
    red, green, blue = np.rint(_LOW + share * (_HIGH - _LOW)).astype(int)
    return f"#{red:02x}{green:02x}{blue:02x}"


def height_range_m(sheet: Sheet) -> tuple[float, float] | None:
    """Lowest and highest point of the path, None for a level one."""
    if sheet.track.climb_m <= _LEVEL_M:
        return None
    height_m = sheet.track.position_m[:, 2]
    return float(height_m.min()), float(height_m.max())


def svg_points(xy: np.ndarray) -> str:
    """SVG point list of (N, 2) coordinates, to a tenth of a unit."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in xy)


def _title(sheet: Sheet) -> str:
    kinds = [describe_kind(segment.kind) for segment in sheet.scenario.segments]
    marked = f", with the segments {', '.join(kinds)}" if kinds else ""
    return f"Path of {sheet.scenario.name} from above, {measured(sheet.track.length_m)} m{marked}"


def _line(path: np.ndarray, colour: str | None = None) -> Markup:
    simplified = cv2.approxPolyDP(path.astype(np.float32)[:, None], _SIMPLIFICATION, False)[:, 0]
    style = Markup(' style="stroke:{}"').format(colour) if colour else ""
    return _LINE.format(svg_points(simplified), style)


def _by_height(path: np.ndarray, height_m: np.ndarray) -> Iterator[Markup]:
    """Draw the path in pieces of one colour each."""
    share = (height_m - height_m.min()) / np.ptp(height_m)
    step = np.minimum((share * _HEIGHT_STEPS).astype(int), _HEIGHT_STEPS - 1)
    bounds = [0, *(np.flatnonzero(np.diff(step)) + 1).tolist(), len(path) - 1]
    for first, last in pairwise(bounds):
        if last > first:
            yield _line(path[first : last + 1], height_colour(step[first] / (_HEIGHT_STEPS - 1)))


def _segments(sheet: Sheet) -> Iterator[Markup]:
    for segment, path_m in zip(sheet.scenario.segments, sheet.track.segments_m, strict=True):
        points = svg_points(sheet.map_frame.place(path_m[:, :2]))
        yield _SEGMENT.format(points, segment.kind, describe_kind(segment.kind))


def _arrows(path: np.ndarray) -> Iterator[Markup]:
    """Draw arrow heads at equal distances along the path."""
    along = arc_length(path)
    for reached in along[-1] * (np.arange(_ARROWS) + 0.5) / _ARROWS:
        at = min(int(np.searchsorted(along, reached)), len(path) - 2)
        dx, dy = path[at + 1] - path[max(at - 1, 0)]
        yield _ARROW.format(*path[at], math.degrees(math.atan2(dy, dx)))


def _frames(sheet: Sheet) -> Iterator[Markup]:
    for number, thumb in enumerate(sheet.thumbs, 1):
        x, y = sheet.map_frame.place(thumb.position_m[:2])
        gaze_x, gaze_y = thumb.gaze[0], -thumb.gaze[1]
        yield _GAZE_LINE.format(x, y, x + _GAZE * gaze_x, y + _GAZE * gaze_y)
        yield _FRAME.format(x, y)
        # Behind the camera, clear of the viewing direction.
        yield _NUMBER.format(x - 9 * gaze_x, y - 9 * gaze_y + 3.5, number)


def _scale_bar(px_per_m: float, height_px: float) -> Markup:
    """Draw a bar of 1, 2 or 5 times a power of ten metres."""
    at_least_m = _SHORTEST_BAR / px_per_m
    power = 10 ** math.floor(math.log10(at_least_m))
    length_m = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= at_least_m)
    y, end = height_px - 10, 10 + length_m * px_per_m
    return _SCALE.format(y - 4, y, end, end + 5, y + 1, length_m)
