"""Plot of the answer: measured and predicted failures per number of threads."""

from typing import Any

from matplotlib.figure import Figure

from experiments.report.plots.style import (
    GREEN,
    ORANGE,
    bars,
    legend_above,
    legend_mark,
    new_figure,
    percent_axis,
)

_SYSTEMS = (
    ("measured", "low", "high", ORANGE, -0.15),
    ("predicted", "predicted_low", "predicted_high", GREEN, 0.15),
)


def draw_answer(report: dict[str, Any], width_in: float) -> Figure | None:
    """Draw both shares with their intervals, a row per number of threads."""
    rows = report["answer"]["rows"]
    if not rows:
        return None
    figure = new_figure(1.1 + 0.5 * len(rows), min(width_in, 5.4))
    axes = figure.subplots()
    for place, row in enumerate(rows):
        for value, low, high, colour, beside in _SYSTEMS:
            if row[value] is not None:
                ends = None if row[low] is None else bars(row[value], row[low], row[high])
                axes.errorbar(row[value], place + beside, xerr=ends, fmt="o", color=colour, elinewidth=1.8)
    axes.set_yticks(range(len(rows)), [f"n = {row['n']}" for row in rows])
    axes.set(ylim=(len(rows) - 0.5, -0.5), xlim=(0, min(axes.get_xlim()[1], 1.0)))
    axes.set_xlabel("failures, share of the trials")
    percent_axis(axes.xaxis)
    axes.grid(visible=False, axis="y")
    handles = [legend_mark(ORANGE, "measured"), legend_mark(GREEN, "predicted by Eq. 1")]
    legend_above(figure, handles, 2, width_in)
    return figure
