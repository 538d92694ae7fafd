"""A sequence along its time: segments, the frames shown, speed, angular rate and height."""

import math

import numpy as np

from experiments.gallery.markup import Element, el, points
from experiments.gallery.plan_map import LEVEL_M
from experiments.gallery.sheet import Sheet
from scenarios.describe import describe_kind, describe_severity, describe_span, measured

_WIDTH, _HEIGHT = 1000.0, 36.0
_MOST_TICKS = 8
_NEAR_THE_END = 0.94


def timeline(sheet: Sheet) -> Element:
    """The rows, all on one axis of time."""
    track, duration_s = sheet.track, sheet.scenario.duration_s
    rows = [
        _row("segments", _bars(sheet)),
        _row(
            f"speed, to {measured(track.speed_mps.max())} m/s", _trace(track.stamps_s, track.speed_mps, 0.0)
        ),
        _row(
            f"rate, to {measured(track.rate_degps.max())} °/s", _trace(track.stamps_s, track.rate_degps, 0.0)
        ),
    ]
    if track.climb_m > LEVEL_M:
        height_m = track.position_m[:, 2]
        label = f"height, {measured(height_m.min())} to {measured(height_m.max())} m"
        rows.append(_row(label, _trace(track.stamps_s, height_m, float(height_m.min()))))
    return el("div", *rows, _row("time", _axis(duration_s)), class_="timeline")


def segment_table(sheet: Sheet) -> Element:
    """The segments with their severities in physical units."""
    if not sheet.scenario.segments:
        return el("p", "No segment: nothing is disturbed.", class_="none")
    rows = [
        el(
            "tr",
            el("td", el("span", class_=f"swatch {s.kind}"), describe_kind(s.kind)),
            el("td", describe_span(s)),
            el("td", describe_severity(s)),
        )
        for s in sheet.scenario.segments
    ]
    head = el("tr", *(el("th", text, scope="col") for text in ("segment", "time", "severity")))
    return el("table", el("thead", head), el("tbody", *rows), class_="segments")


def _row(label: str, content: Element) -> Element:
    return el("div", el("span", label, class_="name"), content, class_="row")


def _bars(sheet: Sheet) -> Element:
    duration_s = sheet.scenario.duration_s
    bars = [
        el(
            "span",
            class_=f"bar {s.kind}",
            style=f"left:{100 * s.start_s / duration_s:.2f}%;width:{100 * s.duration_s / duration_s:.2f}%",
            title=f"{describe_kind(s.kind)}, {describe_span(s)}, {describe_severity(s)}",
        )
        for s in sheet.scenario.segments
    ]
    shown = [
        el("span", str(number), class_="tick", style=f"left:{100 * thumb.stamp_s / duration_s:.2f}%")
        for number, thumb in enumerate(sheet.thumbs, 1)
    ]
    return el("div", *bars, *shown, class_="bars")


def _trace(stamps_s: np.ndarray, values: np.ndarray, base: float) -> Element:
    """A line that fills its box from ``base`` to its highest value."""
    span = max(float(values.max()) - base, 1e-9)
    x = _WIDTH * stamps_s / stamps_s[-1]
    y = _HEIGHT - 1 - (_HEIGHT - 2) * (values - base) / span
    # The highest of every four units: what lies between would hardly be seen.
    columns = np.unique((x / 4).astype(int), return_index=True)[1]
    y = np.minimum.reduceat(y, columns)
    return el(
        "svg",
        el("polyline", points=points(np.column_stack([x[columns], y]))),
        class_="trace",
        viewBox=f"0 0 {_WIDTH:.0f} {_HEIGHT:.0f}",
        preserveAspectRatio="none",
        aria_hidden="true",
    )


def _axis(duration_s: float) -> Element:
    power = 10 ** math.floor(math.log10(duration_s / _MOST_TICKS))
    step_s = next(f * power for f in (1, 2, 5, 10) if f * power * _MOST_TICKS >= duration_s)
    stamps_s = np.arange(0, duration_s + 1e-9, step_s)
    marks = [
        # The first and a last one near the end stay within the axis.
        el(
            "span",
            f"{stamp_s:g} s",
            class_="first" if stamp_s == 0 else "last" if stamp_s > _NEAR_THE_END * duration_s else None,
            style=f"left:{100 * stamp_s / duration_s:.2f}%",
        )
        for stamp_s in stamps_s
    ]
    return el("div", *marks, class_="axis")
