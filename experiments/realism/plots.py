"""Plots of the page: the distributions of all sequences over each other."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dslab.experiments.report.plots.style import (
    BLUE,
    GREEN,
    GREY,
    NARROW_IN,
    ORANGE,
    PURPLE,
    SKY,
    legend_above,
    legend_mark,
    log_ticks,
    new_figure,
)

_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, SKY, GREY)
_LINES = ("-", "--", ":")


def draw_measure(measure: dict[str, Any], width_in: float) -> Figure:
    """Draw the histogram of every sequence as a stepped line.

    Args:
        measure: one of the ``measures`` of ``footage_content``.
        width_in: of the figure.
    """
    figure = new_figure(3.0 if width_in > NARROW_IN else 2.8, width_in)
    axes = figure.subplots()
    edges = np.array(measure["edges"])
    handles = []
    for place, sequence in enumerate(measure["sequences"]):
        colour, line = _look(place)
        if sequence["values"]:
            axes.stairs(
                100 * np.array(sequence["histogram"]), edges, color=colour, linestyle=line, linewidth=1.5
            )
        handles.append(_entry(place, sequence["name"]))
    if measure["log"]:
        axes.set_xscale("log")
        log_ticks(axes.xaxis, edges[0], edges[-1])
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.xaxis.set_minor_formatter(lambda value, _: "")
    axes.set(xlim=(edges[0], edges[-1]), ylim=(0, None), ylabel="per cent per bin")
    axes.set_xlabel(measure["label"])
    legend_above(figure, handles, 3, width_in)
    return figure


def draw_scale(sequences: list[dict[str, Any]], width_in: float) -> Figure | None:
    """Draw the scale along the path of every sequence with truth; None without one."""
    figure = new_figure(3.0, width_in)
    axes = figure.subplots()
    handles = []
    for place, sequence in enumerate(sequences):
        scale = np.array(sequence["scale_along"], float)
        if not len(scale):
            continue
        colour, line = _look(place)
        middle = (np.arange(len(scale)) + 0.5) / len(scale)
        axes.plot(100 * middle, scale, color=colour, linestyle=line, marker="o", markersize=3, linewidth=1.5)
        handles.append(_entry(place, sequence["name"]))
    if not handles:
        return None
    axes.set_xlabel("along the true path, per cent")
    axes.set_ylabel("true over estimated length")
    legend_above(figure, handles, 3, width_in)
    return figure


def _look(place: int) -> tuple[str, str]:
    return _COLOURS[place % len(_COLOURS)], _LINES[place // len(_COLOURS) % len(_LINES)]


def _entry(place: int, name: str) -> Any:
    colour, line = _look(place)
    entry = legend_mark(colour, name, "")
    entry.set_linestyle(line)
    return entry
