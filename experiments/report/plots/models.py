"""Plot of Eq. 1 within conditions, over all of them, and of measured failures."""

from typing import Any

from matplotlib.figure import Figure

from experiments.report.plots.style import (
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    bars,
    log_ticks,
    new_figure,
    percent_axis,
    wrapped,
)

_LEAST_SHARE = 1e-5


def draw_heterogeneity(report: dict[str, Any], width_in: float) -> Figure | None:
    """Draw Eq. 1 within conditions, Eq. 1 of pooled shares and measured shares, per n."""
    levels = [
        level for level in report["analysis"]["heterogeneity"]["eckhardt_lee"] if level["measured"]["units"]
    ]
    if not levels:
        return None
    rows = [row for level in levels for row in _models(level)]
    shown = [v for _, value, low, _, _ in rows for v in (value, low) if v and v > _LEAST_SHARE]
    floor = min(shown, default=1e-3) / 1.5
    figure = new_figure(1.1 + 0.42 * len(rows), width_in)
    axes = figure.subplots()
    for place, (_, value, low, high, colour) in enumerate(rows):
        if value is not None:
            at = max(value, floor)
            xerr = bars(at, at if low is None else max(low, floor), at if high is None else high)
            axes.errorbar(at, place, xerr=xerr, fmt="o", color=colour, elinewidth=1.6, clip_on=False)
    axes.set_yticks(range(len(rows)), [wrapped(name, width_in) for name, *_ in rows], fontsize=9)
    axes.set(xscale="log", ylim=(len(rows) - 0.5, -0.5), xlim=(floor, None))
    axes.set_xlabel("share of failed trials")
    log_ticks(axes.xaxis, *axes.get_xlim())
    percent_axis(axes.xaxis)
    for line in range(len(_models(levels[0])), len(rows), len(_models(levels[0]))):
        axes.axhline(line - 0.5, color=GREY, linewidth=0.7)
    return figure


def _models(level: dict[str, Any]) -> list[tuple[str, float | None, float | None, float | None, str]]:
    measured, n = level["measured"], level["n"]
    named = (
        ("Eq. 1 of pooled shares", level["pooled"], PURPLE),
        ("Eq. 1 within conditions", level["within"], GREEN),
        ("measured", {"value": measured["estimate"], **measured}, ORANGE),
    )
    return [(f"{name}, n = {n}", e["value"], e["low"], e["high"], colour) for name, e, colour in named]
