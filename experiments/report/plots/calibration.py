"""Plot of measured against predicted failures: a test of Eq. 1."""

import math
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.report.plots.style import (
    GREY,
    VERDICT_MARKS,
    bars,
    new_figure,
    percent_axis,
    thread_colour,
)

_LOWEST = 1e-6


def draw_calibration(report: dict[str, Any]) -> Figure | None:
    """Draw measured against predicted shares of every cell and n, on log axes.

    A share below the range of the axes, such as zero, is drawn on their edge.
    """
    marks = report["calibration"]
    drawn = [
        m for m in marks if m["predicted"]["value"] is not None and m["measured"]["estimate"] is not None
    ]
    if not drawn:
        return None
    figure = new_figure(6.6)
    axes = figure.subplots()
    floor = _floor(drawn)
    axes.plot([floor, 1], [floor, 1], color=GREY, linewidth=1.2)
    axes.fill_between([floor, 1], [floor / 2, 0.5], [floor * 2, 2], color="#eeeeee", linewidth=0, zorder=0)
    for mark in drawn:
        _draw_mark(axes, mark, floor)
    axes.set(xscale="log", yscale="log", xlim=(floor, 1.15), ylim=(floor, 1.15), aspect="equal")
    axes.set_xlabel("predicted by Eq. 1 from the crossing arm: p₀ · Π prⱼ")
    axes.set_ylabel("measured in the free arm: share of dual failures")
    percent_axis(axes.xaxis)
    percent_axis(axes.yaxis)
    _legend(axes, drawn)
    return figure


def _floor(drawn: list[dict[str, Any]]) -> float:
    """Power of ten below every share above zero."""
    values = [v for m in drawn for v in (m["predicted"]["value"], m["measured"]["estimate"]) if v]
    lows = [v for m in drawn for v in (m["predicted"]["low"], m["measured"]["low"]) if v]
    least = min(values, default=0.1)
    # Lower limits may be very small: the axes show at most a decade below the least share.
    return max(10 ** math.floor(math.log10(max(min([least, *lows], default=0.1), least / 10))), _LOWEST)


def _draw_mark(axes: Axes, mark: dict[str, Any], floor: float) -> None:
    predicted, measured = mark["predicted"], mark["measured"]
    x, y = max(predicted["value"], floor), max(measured["estimate"], floor)
    colour = thread_colour(mark["n"])
    low = [
        max(end, floor) if end is not None else at
        for end, at in ((predicted["low"], x), (measured["low"], y))
    ]
    high = [end if end is not None else at for end, at in ((predicted["high"], x), (measured["high"], y))]
    axes.errorbar(
        x,
        y,
        xerr=bars(x, low[0], high[0]),
        yerr=bars(y, low[1], high[1]),
        fmt=VERDICT_MARKS[mark["verdict"]],
        color=colour,
        markersize=7.5,
        elinewidth=1,
        alpha=0.85,
        clip_on=False,
    )
    axes.annotate(
        str(mark["number"]), (x, y), xytext=(5, 4), textcoords="offset points", fontsize=9, color=colour
    )


def _legend(axes: Axes, drawn: list[dict[str, Any]]) -> None:
    levels = sorted({mark["n"] for mark in drawn})
    verdicts = [v for v in VERDICT_MARKS if v in {mark["verdict"] for mark in drawn}]
    handles = [Line2D([], [], color=thread_colour(n), linewidth=3, label=f"n = {n}") for n in levels]
    handles += [
        Line2D([], [], color=GREY, marker=VERDICT_MARKS[v], linestyle="", markersize=7, label=v)
        for v in verdicts
    ]
    handles.append(Line2D([], [], color=GREY, linewidth=1.2, label="Eq. 1 (band: ratio of 2)"))
    axes.legend(handles=handles, loc="lower right", fontsize=9)
