"""Plot of the base forward beside the threads of Algorithm 1 backward."""

import textwrap
from typing import Any

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

READINGS = {"declared": "breaks; gets lost", "with_silent": "breaks or is wrong; fails in any way"}
_APART = 0.16


def draw_directions(report: dict[str, Any], width_in: float) -> Figure | None:
    """Draw a panel per reading of what fails: shares of the base and of each thread by condition."""
    found = report["analysis"]["directions"]
    if not found:
        return None
    names = thread_names(report)
    threads = list(dict.fromkeys(each["thread"] for each in found))
    conditions = list(dict.fromkeys((each["kind"], each["world"]) for each in found))
    labels = [
        textwrap.fill(f"{describe_label(kind)}, {world.replace('_', ' ')}", 12) for kind, world in conditions
    ]
    figure, places = panels(len(READINGS), 2, width_in, 2.4, 0.7, sharey=True)
    for axes, (reading, words) in zip(places, READINGS.items(), strict=True):
        for each in found:
            at = conditions.index((each["kind"], each["world"]))
            order = threads.index(each["thread"])
            if not order:
                draw_share(axes, at - _APART, each[reading]["forward"], BLUE, "o")
            beside = at + _APART * order
            draw_share(axes, beside, each[reading]["backward"], thread_colour(each["thread"]), "^")
        shares_over(axes, labels)
        axes.tick_params(axis="x", labelsize=7)
        axes.set_title(words, fontsize=9, loc="left")
    marks = [legend_mark(BLUE, "base, forward")]
    marks += [legend_mark(thread_colour(j), f"{names[j - 1]}, backward", "^") for j in threads]
    legend_above(figure, marks, 3, width_in)
    return figure
