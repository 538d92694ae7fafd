"""Plot of the paper's own tables against Eq. 1."""

from typing import Any

from matplotlib.figure import Figure

from dslab.experiments.report.plots.style import (
    GREEN,
    ORANGE,
    WIDE_IN,
    bars,
    log_ticks,
    new_figure,
    percent_axis,
)


def draw_paper(rows: list[dict[str, Any]]) -> Figure:
    """Draw published failures and predictions of Eq. 1 per row of Table III.

    Args:
        rows: rows of the re-analysis as plain data.
    """
    figure = new_figure(1.6 + 0.42 * len(rows), WIDE_IN)
    axes = figure.subplots()
    for place, row in enumerate(rows):
        pairs = (
            (row["predicted"]["value"], row["predicted"], GREEN, "predicted by Eq. 1: p₀ · pr²", -0.13),
            (row["measured"]["estimate"], row["measured"], ORANGE, "published failures", 0.13),
        )
        for at, ends, colour, label, beside in pairs:
            axes.errorbar(
                at,
                place + beside,
                xerr=bars(at, ends["low"], ends["high"]),
                fmt="o",
                color=colour,
                elinewidth=1.5,
                label=None if place else label,
            )
    names = [f"{row['counts']['system']}, {row['counts']['dataset']}" for row in rows]
    axes.set_yticks(range(len(rows)), names)
    axes.set(xscale="log", ylim=(len(rows) - 0.5, -0.5))
    log_ticks(axes.xaxis, *axes.get_xlim())
    percent_axis(axes.xaxis)
    axes.set_xlabel("share of trials in which the whole system fails (assuming independent trials)")
    figure.legend(loc="outside upper left", ncols=2, fontsize=9)
    return figure
