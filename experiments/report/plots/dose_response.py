"""Plot of failures against the dose of the stress."""

from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.report.conditions import describe_quantity, doses_of, thread_names
from experiments.report.plots.style import (
    BLUE,
    NARROW_IN,
    bars,
    new_figure,
    percent_axis,
    thread_colour,
)
from scenarios.describe import describe_kind, plain

_MOST_TICKS = 5


def draw_dose_response(report: dict[str, Any], width_in: float) -> Figure | None:
    """Draw a panel per kind of degradation and probability: p0, and pr of each thread.

    Kinds are rows; on a narrow page their panels fill rows of two.
    """
    fits = [fit for fit in report["analysis"]["dose_response"] if fit["points"]]
    kinds = {kind: list(own) for kind, own in groupby(fits, key=lambda fit: fit["kind"])}
    if not kinds:
        return None
    most = max(len(own) for own in kinds.values())
    columns = most if width_in > NARROW_IN else min(most, 2)
    deep = -(-most // columns)
    figure = new_figure(0.3 + 2.1 * deep * len(kinds), min(width_in, 2.8 * columns))
    panels = figure.subplots(deep * len(kinds), columns, squeeze=False, sharey=True)
    names = thread_names(report)
    for place, (kind, own) in enumerate(kinds.items()):
        of_kind = panels[deep * place : deep * (place + 1)].ravel()
        for axes, fit in zip(of_kind, own, strict=False):
            _draw_fit(axes, fit)
            title = f"{describe_kind(kind)}:\n{describe_quantity(fit['quantity'], names)}"
            axes.set_title(title, fontsize=9, loc="left")
            _label_doses(axes, doses_of(report["conditions"], kind))
        for empty in of_kind[len(own) :]:
            empty.remove()
    for axes in panels[:, 0]:
        axes.set_ylabel("trials", fontsize=9)
    return figure


def _draw_fit(axes: Axes, fit: dict[str, Any]) -> None:
    number = fit["quantity"].removeprefix("p").removeprefix("r")
    colour = thread_colour(int(number)) if fit["quantity"] != "p0" else BLUE
    if fit["curve"]:
        severity, middle, low, high = zip(*fit["curve"], strict=True)
        axes.plot(severity, middle, color=colour, linewidth=1.6)
        axes.fill_between(severity, low, high, color=colour, alpha=0.12, linewidth=0)
    for point in fit["points"]:
        share = point["proportion"]
        if share["estimate"] is not None:
            ends = bars(share["estimate"], share["low"], share["high"])
            axes.errorbar(
                point["severity"],
                share["estimate"],
                yerr=ends,
                fmt="o",
                markersize=5,
                color=colour,
                elinewidth=1,
            )
    axes.set_ylim(-0.03, 1.03)
    percent_axis(axes.yaxis)
    axes.tick_params(labelsize=8)


def _label_doses(axes: Axes, doses: list[dict[str, Any]]) -> None:
    """Ticks at the tested doses, in their unit; of many only some are named."""
    shown = [doses[i] for i in np.unique(np.linspace(0, len(doses) - 1, _MOST_TICKS).round().astype(int))]
    axes.set_xticks([d["severity"] for d in shown], [plain(d["value"]) for d in shown])
    axes.set_xlabel(doses[0]["axis"], fontsize=9)
