"""Plot of the chain from Eq. 1 to what is measured, a figure per kind of degradation."""

from math import isfinite
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dslab.experiments.report.plots.style import GREY, bars, log_ticks, panels, plain_ticks, thread_colour

_STEPS = ("world", "path", "sequence", "run", "arms", "whole")
_NAMES = {"whole": "D / Eq. 1"}
_LEAST, _MOST = 3.0, 30.0
"""Least and largest end of the axis of ratios; its other end is one over that."""


def draw_chain(report: dict[str, Any], kind: str, width_in: float) -> Figure | None:
    """Draw the steps as ratios on a log axis, a panel per dose, kind of world and n.

    Conditions in which Eq. 1 predicts no failure have no ratio, hence no panel.
    """
    cells = [cell for cell in report["analysis"]["cells"] if cell["kind"] == kind and cell["steps"]]
    if not cells:
        return None
    named = {condition["cell"]: condition for condition in report["conditions"]}
    cells.sort(key=lambda cell: (cell["world"], named[cell["cell"]]["number"], cell["n"]))
    steps = [step for step in _STEPS if any(step in cell["steps"] for cell in cells)]
    figure, places = panels(len(cells), 2, width_in, 0.75 + 0.2 * len(steps), 0.35, sharex=True)
    limit = _limit(cells)
    for axes, cell in zip(places, cells, strict=True):
        _draw_cell(axes, cell, steps, limit)
        c = named[cell["cell"]]
        world = cell["world"].replace("_", " ")
        axes.set_title(
            f"{c['number']}. {world}, {c['dose']}, n = {cell['n']}"
            f"{' (confirmatory)' if cell['confirmatory'] else ''}\n"
            f"Q: {cell['verdict_in_units']}, D: {cell['verdict_forecast']}",
            fontsize=8.5,
            loc="left",
        )
        axes.tick_params(labelbottom=True, labelsize=8)
    return figure


def _limit(cells: list[dict[str, Any]]) -> float:
    """End of the axis: what holds every value and bounded end, within limits."""
    shown = [v for cell in cells for step in cell["steps"].values() for v in step.values() if v]
    ratios = [max(v, 1 / v) for v in shown if isfinite(v)]
    return min(max([_LEAST, *(1.15 * r for r in ratios)]), _MOST)


def _draw_cell(axes: Axes, cell: dict[str, Any], steps: list[str], limit: float) -> None:
    colour = thread_colour(cell["n"])
    axes.axvline(1, color=GREY, linewidth=1)
    for place, step in enumerate(steps):
        if step not in cell["steps"]:
            continue
        ratio = cell["steps"][step]
        value = ratio["value"]
        low, high = ratio["low"] or 0.0, limit * 2 if ratio["high"] is None else ratio["high"]
        at, left, right = (min(max(v, 1 / limit), limit) for v in (value, low, high))
        axes.errorbar(at, place, xerr=bars(at, left, right), fmt="none", ecolor=colour, elinewidth=1.6)
        mark = "o" if 1 / limit <= value <= limit else "<" if value < 1 else ">"
        axes.plot(at, place, mark, color=colour, markersize=5.5, clip_on=False, zorder=3)
        for beyond, end, arrow in ((low < 1 / limit, 1 / limit, "<"), (high > limit, limit, ">")):
            if beyond and end != at:
                axes.plot(end, place, arrow, color=colour, markersize=5, clip_on=False, mfc="white")
    axes.set(xscale="log", xlim=(1 / limit, limit), ylim=(len(steps) - 0.5, -0.5))
    axes.set_yticks(range(len(steps)), [_NAMES.get(step, step) for step in steps], fontsize=8)
    log_ticks(axes.xaxis, 1 / limit, limit)
    plain_ticks(axes.xaxis)
    axes.grid(visible=False, axis="y")
