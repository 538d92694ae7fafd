"""Plot of how far each formula is off, per condition."""

from typing import Any

from matplotlib.figure import Figure

from dslab.experiments.report.plots.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PALE,
    PURPLE,
    legend_above,
    legend_mark,
    panels,
    percent_axis,
)

_STYLES = {
    "Eq. 1": (ORANGE, "o"),
    "weakest link": (GREEN, "^"),
    "beta factor": (BLUE, "s"),
    "one factor": (PURPLE, "D"),
    "ceiling": (PALE, "|"),
}


def draw_formulas(report: dict[str, Any], width_in: float) -> Figure | None:
    """Draw mean prediction minus mean outcome, a row per condition, a panel per n and set of worlds."""
    found = report["analysis"]["formulas"]
    if not found:
        return None
    named = {condition["cell"]: condition for condition in report["conditions"]}
    most = max(len(formulas["cells"]) for formulas in found)
    figure, places = panels(len(found), 2, width_in, 0.8 + 0.2 * most, 0.6)
    # One panel per set of worlds beside that of the next n.
    found = sorted(found, key=lambda formulas: (formulas["cells"], formulas["n"]))
    for axes, formulas in zip(places, found, strict=True):
        axes.axvline(0, color=GREY, linewidth=1)
        for score in formulas["on_dual_failures"]:
            colour, mark = _STYLES[score["name"]]
            axes.plot(score["calibration"], range(len(formulas["cells"])), mark, color=colour, markersize=5)
        names = [f"{named[cell]['number']}. {world.replace('_', ' ')}" for cell, world in formulas["cells"]]
        axes.set_yticks(range(len(names)), names, fontsize=8)
        axes.set_ylim(len(names) - 0.5, -0.5)
        axes.set_title(f"n = {formulas['n']}, {formulas['worlds']} worlds", fontsize=9, loc="left")
        axes.tick_params(axis="x", labelsize=8)
        percent_axis(axes.xaxis)
    told = {score["name"] for formulas in found for score in formulas["on_dual_failures"]}
    marks = [legend_mark(colour, name, mark) for name, (colour, mark) in _STYLES.items() if name in told]
    legend_above(figure, marks, 5, width_in)
    return figure
