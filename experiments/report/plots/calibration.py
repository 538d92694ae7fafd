"""Plot of measured against predicted failures: a test of Eq. 1."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator

from experiments.report.plots.style import (
    GREY,
    NARROW_IN,
    THREAD_MARKS,
    bars,
    legend_above,
    legend_mark,
    new_figure,
    percent_axis,
    thread_colour,
)

_TICKS, _FEW_TICKS = (0, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1), (0, 0.05, 0.2, 0.4, 0.7, 1)

_NEAR_ZERO = 0.005


def draw_calibration(report: dict[str, Any], width_in: float) -> Figure | None:
    """Draw measured against predicted shares of every cell and n.

    The axes grow with the square root of a share: small ones are told apart, and zero has its place.
    """
    drawn = [
        m
        for m in report["calibration"]
        if m["predicted"]["value"] is not None and m["measured"]["estimate"] is not None
    ]
    if not drawn:
        return None
    side = min(width_in, 6.2)
    figure = new_figure(side + 0.3, side)
    axes = figure.subplots()
    most = max(end or 0 for m in drawn for end in (m["predicted"]["high"], m["measured"]["high"]))
    end = min(max(1.1 * most, 0.01), 1.0)
    axes.plot([0, end], [0, end], color=GREY, linewidth=1.2)
    axes.fill_between([0, end], [0, end / 2], [0, end * 2], color="#eeeeee", linewidth=0, zorder=0)
    for mark in drawn:
        _draw_mark(axes, mark)
    _number(axes, drawn)
    axes.set_xscale("function", functions=(_root, np.square))
    axes.set_yscale("function", functions=(_root, np.square))
    ticks = _TICKS if width_in > NARROW_IN else _FEW_TICKS
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(FixedLocator([t for t in ticks if t <= end]))
        percent_axis(axis)
    axes.set(xlim=(0, end), ylim=(0, end), aspect="equal")
    axes.set_xlabel("predicted by Eq. 1: p₀ · Π prⱼ")
    axes.set_ylabel("measured: share of failed trials")
    levels = sorted({mark["n"] for mark in drawn})
    handles = [legend_mark(thread_colour(n), f"n = {n}", _shape(n)) for n in levels]
    handles.append(Line2D([], [], color=GREY, linewidth=1.2, label="Eq. 1 (band: factor of 2)"))
    legend_above(figure, handles, 4, width_in)
    return figure


def _root(share: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(share, 0))


def _shape(n: int) -> str:
    return THREAD_MARKS[(n - 1) % len(THREAD_MARKS)]


def _draw_mark(axes: Axes, mark: dict[str, Any]) -> None:
    predicted, measured = mark["predicted"], mark["measured"]
    x, y = predicted["value"], measured["estimate"]
    axes.errorbar(
        x,
        y,
        xerr=bars(x, predicted["low"], predicted["high"]),
        yerr=bars(y, measured["low"], measured["high"]),
        fmt=_shape(mark["n"]),
        color=thread_colour(mark["n"]),
        # A later point on the same place lets the earlier one be seen.
        markersize=10 - 2 * min(mark["n"], 3),
        elinewidth=max(3 - mark["n"], 0.8),
        alpha=0.85,
        clip_on=False,
    )


def _number(axes: Axes, drawn: list[dict[str, Any]]) -> None:
    """Write the conditions' numbers beside their points, those of one place together."""
    places: dict[tuple[int, float, float], list[int]] = {}
    for mark in drawn:
        x, y = (round(share, 3) for share in (mark["predicted"]["value"], mark["measured"]["estimate"]))
        places.setdefault((mark["n"], x, y), []).append(mark["number"])
    for (n, x, y), numbers in places.items():
        axes.annotate(
            ", ".join(map(str, numbers)),
            (x, y),
            xytext=(5, 4 if n % 2 else -11 if y > _NEAR_ZERO else 14),
            textcoords="offset points",
            fontsize=9,
            color=thread_colour(n),
        )
