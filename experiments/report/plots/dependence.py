"""Plot of the risk ratio of failed recovery given breakage, per cell and thread."""

from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from experiments.report.plots.style import (
    GREY,
    bars,
    direct_legend,
    log_ticks,
    new_figure,
    shorten,
    thread_colour,
)

_WIDEST = 100.0


def draw_dependence(report: dict[str, Any]) -> Figure | None:
    """Draw the ratios rho_j = P(R_j|B) / P(R_j) with intervals; 1 is independence."""
    cells = report["analysis"]["cells"]
    rows = [
        (place, thread["thread"], thread["rho"])
        for place, cell in enumerate(cells)
        for thread in cell["threads"]
        if thread["rho"]["value"]
    ]
    if not rows:
        return None
    threads = sorted({thread for _, thread, _ in rows})
    figure = new_figure(1.6 + 0.34 * len(cells))
    axes = figure.subplots()
    axes.axvline(1, color=GREY, linewidth=1.2)
    for thread in threads:
        colour, label = thread_colour(thread), f"thread {thread}"
        for place, _, rho in (row for row in rows if row[1] == thread):
            value = min(max(rho["value"], 1 / _WIDEST), _WIDEST)
            low = value if rho["low"] is None else max(rho["low"], 1 / _WIDEST)
            high = value if rho["high"] is None else min(rho["high"], _WIDEST)
            y = place + 0.24 * (thread - (len(threads) + 1) / 2)
            axes.errorbar(
                value, y, xerr=bars(value, low, high), fmt="o", color=colour, elinewidth=1.4, label=label
            )
            label = None
    axes.set_yticks(range(len(cells)), [shorten(cell["cell"]) for cell in cells])
    axes.set_ylim(len(cells) - 0.4, -0.6)
    axes.set_xscale("log")
    axes.set_xlabel("P(Rⱼ | B) / P(Rⱼ): 1 if recovery fails equally often with and without breakage")
    log_ticks(axes.xaxis, *axes.get_xlim())
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    direct_legend(axes, loc="best")
    return figure
