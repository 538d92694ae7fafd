"""Plot of shares against the dose of the stress."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dslab.experiments.report.conditions import describe_label, thread_names
from dslab.experiments.report.plots.style import (
    BLUE,
    NARROW_IN,
    bars,
    legend_above,
    legend_mark,
    new_figure,
    percent_axis,
    thread_colour,
)
from dslab.scenarios.describe import plain

_APART = 0.13


def draw_doses(report: dict[str, Any], width_in: float) -> Figure | None:
    """Draw a panel per kind of degradation and setting, doses in their unit, in the order of the spec."""
    points = report["analysis"]["doses"]
    if not points:
        return None
    kinds = list(dict.fromkeys((point["kind"], point["world"], point["setting"]) for point in points))
    named = {condition["cell"]: condition for condition in report["conditions"]}
    styles = _styles(report)
    columns = min(2 if width_in > NARROW_IN else 1, len(kinds))
    rows = -(-len(kinds) // columns)
    figure = new_figure(0.7 + 2.0 * rows, width_in)
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    for axes, (kind, world, setting) in zip(panels, kinds, strict=False):
        own = [p for p in points if (p["kind"], p["world"], p["setting"]) == (kind, world, setting)]
        for place, point in enumerate(own):
            _draw_point(axes, place, point["shares"], styles)
        of = [named[point["cell"]] for point in own]
        labels = [plain(c["value"]) if c["field"] else "none" for c in of]
        axes.set_xticks(range(len(own)), labels, fontsize=8)
        axes.set_xlabel(of[-1]["axis"], fontsize=9)
        axes.set_xlim(-0.5, len(own) - 0.5)
        where = world if setting in ("", world) else f"{world}, {setting}"
        axes.set_title(f"{describe_label(kind)}, {where.replace('_', ' ')}", fontsize=9, loc="left")
        axes.set_ylim(-0.03, 1.03)
        percent_axis(axes.yaxis)
        axes.tick_params(axis="y", labelsize=8, labelleft=True)
        axes.grid(visible=False, axis="x")
    for empty in panels[len(kinds) :]:
        empty.remove()
    legend_above(figure, [legend_mark(c, label, mark) for c, label, mark in styles.values()], 3, width_in)
    return figure


def _styles(report: dict[str, Any]) -> dict[str, tuple[str, str, str]]:
    """Colour, label and mark of each share that any dose has."""
    names = thread_names(report)
    styles = {"breakage": (BLUE, "tracking breaks", "o")}
    for j, name in enumerate(names, 1):
        styles[f"thread_{j}"] = (thread_colour(j), f"{name} fails to cross", "^")
    for j in range(1, len(names) + 1):
        styles[f"dual_{j}"] = (thread_colour(j), f"D, {' and '.join(names[:j])}", "s")
    told = {name for point in report["analysis"]["doses"] for name in point["shares"]}
    return {name: style for name, style in styles.items() if name in told}


def _draw_point(axes: Axes, place: int, shares: dict[str, Any], styles: dict[str, Any]) -> None:
    middle = (len(styles) - 1) / 2
    for number, (name, (colour, _, mark)) in enumerate(styles.items()):
        if share := shares.get(name):
            ends = bars(share["value"], share["low"], share["high"])
            at = place + _APART * (number - middle)
            axes.errorbar(at, share["value"], yerr=ends, fmt=mark, color=colour, markersize=4.5, elinewidth=1)
