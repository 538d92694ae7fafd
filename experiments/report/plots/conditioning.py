"""Plot of two-view pose error against baseline, after Fig. 2 of the paper."""

import math
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dslab.experiments.report.conditioning import QUANTITY_WORDS
from dslab.experiments.report.describe import number
from dslab.experiments.report.plots.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    legend_above,
    log_ticks,
    panels,
    plain_ticks,
)

_COLOURS = (BLUE, ORANGE, GREEN, PURPLE)


def draw_conditioning(report: dict[str, Any], width_in: float) -> Figure | None:
    """Draw a log-log panel per error: points per lead-in and gap, medians, slope."""
    found = report["analysis"]["conditioning"]
    if not found:
        return None
    figure, places = panels(len(found), len(found), width_in, 3.3, 0.4)
    for axes, errors in zip(places, found, strict=True):
        _draw_panel(axes, errors, report["conditioning"]["marks"])
    legend_above(figure, places[0].get_legend_handles_labels()[0], 4, width_in)
    return figure


def _draw_panel(axes: Axes, errors: dict[str, Any], marks: list[dict[str, Any]]) -> None:
    quantity = errors["quantity"]
    _draw_slope(axes, errors)
    for place, gap in enumerate(errors["gaps"]):
        colour = _COLOURS[place % len(_COLOURS)]
        own = [m for m in marks if m["gap"] == gap["gap"] and m[quantity] and m["baseline_m"]]
        axes.plot(
            [m["baseline_m"] for m in own],
            [m[quantity] for m in own],
            "o", color=colour, markersize=4, alpha=0.3, markeredgewidth=0,
        )  # fmt: skip
        axes.plot(
            gap["baseline_m"],
            gap["error"],
            "D", color=colour, markersize=7, markeredgecolor="white", zorder=3,
            label=f"{gap['gap']} frame{'s' if gap['gap'] > 1 else ''} apart",
        )  # fmt: skip
    axes.set(xscale="log", yscale="log")
    slope = errors["slope"] and errors["slope"]["value"]
    suffix = "" if slope is None else f": slope {number(slope)}"
    axes.set_title(QUANTITY_WORDS[quantity] + suffix, fontsize=10)
    axes.set_xlabel("true baseline (m)")
    axes.set_ylabel("error (deg)")
    for axis, limits in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        log_ticks(axis, *limits)
        plain_ticks(axis)


def _draw_slope(axes: Axes, errors: dict[str, Any]) -> None:
    """Draw the slope over all gaps; without an intercept, through the centre of the medians."""
    slope = errors["slope"] and errors["slope"]["value"]
    points = [(g["baseline_m"], g["error"]) for g in errors["gaps"] if g["error"]]
    if slope is None or len(points) < 2:
        return
    x, y = ([math.log(value) for value in axis] for axis in zip(*points, strict=True))
    middle = sum(x) / len(x), sum(y) / len(y)
    ends = min(x), max(x)
    axes.plot(
        [math.exp(end) for end in ends],
        [math.exp(middle[1] + slope * (end - middle[0])) for end in ends],
        "--", color=GREY, linewidth=1.4, zorder=1,
    )  # fmt: skip
