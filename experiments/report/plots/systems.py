"""Plot of the systems beside each other: breakages and failed missions against the dose."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dslab.experiments.report.conditions import describe_label
from dslab.experiments.report.plots.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    draw_share,
    legend_above,
    legend_mark,
    panels,
    shares_over,
)
from dslab.scenarios.describe import plain

_STYLES = ((BLUE, "o"), (ORANGE, "^"), (GREEN, "s"), (PURPLE, "D"), (SKY, "v"), (GREY, "P"))
_FAILURES = {"breakage": "breaks", "mission_failure": "mission fails"}
_WIDTH = 0.6


def draw_systems(report: dict[str, Any], width_in: float) -> Figure | None:
    """Draw a row per kind of degradation, base and kind of world: breakages, and failed missions."""
    if report["systems"] is None or not any(point["units"] for point in report["systems"]["shares"]):
        return None
    named = {condition["cell"]: condition for condition in report["conditions"]}
    points = [point | named[point["cell"]] for point in report["systems"]["shares"]]
    names = report["systems"]["names"]
    shown = list(dict.fromkeys(_row(point) for point in points if point["field"]))
    each = [(row, failure) for row in shown for failure in _FAILURES]
    figure, places = panels(len(each), len(_FAILURES), width_in, 2.0, 0.7, sharey=True)
    for axes, (row, failure) in zip(places, each, strict=True):
        own = [p for p in points if _row(p) == row]
        sham = [p for p in points if not p["field"] and _place(p) == row[1:]]
        _draw(axes, [*sham, *own], failure, names)
        kind, base, world = row
        where = world if base in ("", world) else f"{base}, {world}"
        axes.set_title(
            f"{describe_label(kind)}, {where.replace('_', ' ')}: {_FAILURES[failure]}", fontsize=9, loc="left"
        )
        axes.set_xlabel(own[-1]["axis"], fontsize=9)
    legend_above(
        figure, [legend_mark(*_style(i)[:1], name, _style(i)[1]) for i, name in enumerate(names)], 4, width_in
    )
    return figure


def _place(point: dict[str, Any]) -> tuple[str, str]:
    """Base, where there are several, and kind of world of a point."""
    parts = point["image"].split("/")
    return "" if parts[0] == point["kind"] else parts[0], point["world"]


def _row(point: dict[str, Any]) -> tuple[str, str, str]:
    return point["kind"], *_place(point)


def _style(number: int) -> tuple[str, str]:
    return _STYLES[number % len(_STYLES)]


def _draw(axes: Axes, points: list[dict[str, Any]], failure: str, names: list[str]) -> None:
    images = list(dict.fromkeys(point["image"] for point in points))
    for number, name in enumerate(names):
        own = [p for p in points if p["system"] == name and p["shares"].get(failure)]
        beside = _WIDTH * ((number + 0.5) / len(names) - 0.5)
        places = [images.index(point["image"]) + beside for point in own]
        shares = [point["shares"][failure] for point in own]
        colour, mark = _style(number)
        axes.plot(places, [s["value"] for s in shares], color=colour, linewidth=0.8, alpha=0.6)
        for place, share in zip(places, shares, strict=True):
            draw_share(axes, place, share, colour, mark)
    values = {point["image"]: plain(point["value"]) if point["field"] else "none" for point in points}
    shares_over(axes, [values[image] for image in images])
