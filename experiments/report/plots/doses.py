"""Plot of shares against the dose of the stress."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dslab.experiments.report.conditions import describe_label, thread_names
from dslab.experiments.report.plots.style import (
    BLUE,
    draw_share,
    legend_above,
    legend_mark,
    panels,
    shares_over,
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
    figure, places = panels(len(kinds), 2, width_in, 2.0, 0.7, sharey=True)
    for axes, (kind, world, setting) in zip(places, kinds, strict=True):
        own = [p for p in points if (p["kind"], p["world"], p["setting"]) == (kind, world, setting)]
        for place, point in enumerate(own):
            _draw_point(axes, place, point["shares"], styles)
        of = [named[point["cell"]] for point in own]
        labels = [plain(c["value"]) if c["field"] else "none" for c in of]
        shares_over(axes, labels)
        axes.set_xlabel(of[-1]["axis"], fontsize=9)
        where = world if setting in ("", world) else f"{world}, {setting}"
        axes.set_title(f"{describe_label(kind)}, {where.replace('_', ' ')}", fontsize=9, loc="left")
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
            draw_share(axes, place + _APART * (number - middle), share, colour, mark)
