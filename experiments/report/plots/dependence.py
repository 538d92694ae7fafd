"""Plot of the risk ratio of failed recovery given breakage, per cell and thread."""

from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from experiments.report.conditions import thread_names
from experiments.report.plots.style import (
    GREY,
    bars,
    legend_above,
    legend_mark,
    log_ticks,
    new_figure,
    thread_colour,
    wrapped,
)

_WIDEST = 100.0


def draw_dependence(report: dict[str, Any], width_in: float) -> Figure | None:
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
    names = {c["cell"]: wrapped(c["name"], width_in) for c in report["conditions"]}
    lines = sum(names[cell["cell"]].count("\n") + 1 for cell in cells)
    figure = new_figure(1.6 + 0.18 * lines + 0.2 * len(cells), width_in)
    axes = figure.subplots()
    axes.axvline(1, color=GREY, linewidth=1.2)
    for thread in threads:
        colour = thread_colour(thread)
        for place, _, rho in (row for row in rows if row[1] == thread):
            value = min(max(rho["value"], 1 / _WIDEST), _WIDEST)
            low = value if rho["low"] is None else max(rho["low"], 1 / _WIDEST)
            high = value if rho["high"] is None else min(rho["high"], _WIDEST)
            y = place + 0.24 * (thread - (len(threads) + 1) / 2)
            axes.errorbar(value, y, xerr=bars(value, low, high), fmt="o", color=colour, elinewidth=1.4)
    axes.set_yticks(range(len(cells)), [names[cell["cell"]] for cell in cells], fontsize=9)
    axes.set_ylim(len(cells) - 0.4, -0.6)
    axes.set_xscale("log")
    least, most = axes.get_xlim()
    axes.set_xlim(min(least, 0.45), max(most, 2.2))
    axes.set_xlabel("P(Rⱼ | B) / P(Rⱼ)")
    log_ticks(axes.xaxis, *axes.get_xlim())
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    threads_named = thread_names(report)
    legend_above(figure, [legend_mark(thread_colour(t), threads_named[t - 1]) for t in threads], 4, width_in)
    return figure
