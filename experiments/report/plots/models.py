"""Plots of dose and response, and of models of coinciding failures."""

from itertools import groupby
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.report.plots.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    bars,
    log_ticks,
    new_figure,
    percent_axis,
    shorten,
    thread_colour,
)

_COLUMNS = 3
_LEAST_SHARE = 1e-5


def draw_dose_response(report: dict[str, Any]) -> Figure | None:
    """Draw p0 and every pr_j against severity, a panel per degradation kind."""
    fits = [fit for fit in report["analysis"]["dose_response"] if fit["points"]]
    kinds = {kind: list(own) for kind, own in groupby(fits, key=lambda fit: fit["kind"])}
    if not kinds:
        return None
    columns = min(_COLUMNS, len(kinds))
    rows = -(-len(kinds) // columns)
    figure = new_figure(0.5 + 2.9 * rows, 3.4 * columns)
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    for axes, (kind, own) in zip(panels, kinds.items(), strict=False):
        for place, fit in enumerate(own):
            _draw_fit(axes, fit, place - (len(own) - 1) / 2)
        axes.set_title(shorten(kind.replace("_", " "), 30), fontsize=10)
        axes.set_xlabel("severity", fontsize=9)
        axes.set_ylim(-0.03, 1.03)
        percent_axis(axes.yaxis)
    for empty in panels[len(kinds) :]:
        empty.remove()
    panels[0].set_ylabel("share of units")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=4 if columns > 1 else 1, fontsize=9)
    return figure


def _draw_fit(axes: Axes, fit: dict[str, Any], place: float) -> None:
    colour = _quantity_colour(fit["quantity"])
    if fit["curve"]:
        severity, middle, low, high = zip(*fit["curve"], strict=True)
        axes.plot(severity, middle, color=colour, linewidth=1.6)
        axes.fill_between(severity, low, high, color=colour, alpha=0.12, linewidth=0)
    doses = [point["severity"] for point in fit["points"]]
    # Points of equal dose are drawn side by side.
    shift = place * 0.02 * ((max(doses) - min(doses)) or 1)
    label = _quantity_words(fit["quantity"])
    for point in fit["points"]:
        share = point["proportion"]
        if share["estimate"] is not None:
            at = share["estimate"]
            axes.errorbar(
                point["severity"] + shift,
                at,
                yerr=bars(at, share["low"], share["high"]),
                fmt="o",
                markersize=5,
                color=colour,
                elinewidth=1,
                label=label,
            )
            label = None


def _quantity_colour(quantity: str) -> str:
    return BLUE if quantity == "p0" else thread_colour(int(quantity.removeprefix("pr") or 1))


def _quantity_words(quantity: str) -> str:
    return (
        "p₀: tracking breaks" if quantity == "p0" else f"pr, thread {quantity.removeprefix('pr')} (crossing)"
    )


def draw_heterogeneity(report: dict[str, Any]) -> Figure | None:
    """Draw Eq. 1 within cells, Eq. 1 of pooled shares and measured shares, per n."""
    levels = [
        level for level in report["analysis"]["heterogeneity"]["eckhardt_lee"] if level["measured"]["units"]
    ]
    if not levels:
        return None
    rows = [row for level in levels for row in _models(level)]
    shown = [v for _, value, low, _, _ in rows for v in (value, low) if v and v > _LEAST_SHARE]
    floor = min(shown, default=1e-3) / 1.5
    figure = new_figure(1.1 + 0.36 * len(rows))
    axes = figure.subplots()
    for place, (_, value, low, high, colour) in enumerate(rows):
        if value is not None:
            at = max(value, floor)
            xerr = bars(at, at if low is None else max(low, floor), at if high is None else high)
            axes.errorbar(at, place, xerr=xerr, fmt="o", color=colour, elinewidth=1.6, clip_on=False)
    axes.set_yticks(range(len(rows)), [name for name, *_ in rows])
    axes.set(xscale="log", ylim=(len(rows) - 0.5, -0.5), xlim=(floor, None))
    axes.set_xlabel("share of units in which the whole system fails")
    log_ticks(axes.xaxis, *axes.get_xlim())
    percent_axis(axes.xaxis)
    for line in range(len(_models(levels[0])), len(rows), len(_models(levels[0]))):
        axes.axhline(line - 0.5, color=GREY, linewidth=0.7)
    return figure


def _models(level: dict[str, Any]) -> list[tuple[str, float | None, float | None, float | None, str]]:
    measured, n = level["measured"], level["n"]
    named = (
        ("Eq. 1 of pooled shares", level["pooled"], PURPLE),
        ("Eq. 1 within cells, averaged", level["within"], GREEN),
        ("measured", {"value": measured["estimate"], **measured}, ORANGE),
    )
    return [(f"{name}, n = {n}", e["value"], e["low"], e["high"], colour) for name, e, colour in named]
