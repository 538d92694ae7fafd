"""Plot of a boundary search: trials, the curve of the failure over the dose with its band, the boundary."""

import textwrap
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, NullFormatter

from dslab.experiments.report.plots.style import (
    BLUE,
    GREY,
    NARROW_IN,
    ORANGE,
    PALE,
    log_ticks,
    new_figure,
    percent_axis,
)
from dslab.scenarios.describe import plain

_ROW, _PILE = 0.035, 0.4
"""Distance of two trials of the same dose and outcome, and most height of them all, as probabilities."""


def draw_boundary(found: dict[str, Any], width_in: float, searched: Sequence[str] = ()) -> Figure:
    """Draw the figures of ``boundary_content``: stress grows to the right, also where less is stronger.

    Args:
        found: the figures.
        width_in: width in inches.
        searched: lines that say what was searched, written below.
    """
    figure = new_figure(4.2 + 0.17 * len(searched), width_in)
    shams, axes = figure.subplots(1, 2, sharey=True, width_ratios=(1, 11))
    curve = found["curve"]
    axes.set_xscale("log")
    axes.fill_between(curve["dose"], curve["low"], curve["high"], color=BLUE, alpha=0.18, linewidth=0)
    axes.plot(curve["dose"], curve["probability"], color=BLUE)
    ends = np.sort([found["weakest"], found["strongest"]])
    room = (ends[1] / ends[0]) ** 0.03
    low, high = ends[0] / room, ends[1] * room
    axes.set_xlim((low, high) if found["stronger"] == "more" else (high, low))
    _draw_answer(axes, found)
    for place, of in ((axes, "dose"), (shams, "sham")):
        trials = [t for t in found["trials"] if (t["dose"] is None) == (of == "sham")]
        _draw_trials(place, trials)
    log_ticks(axes.xaxis, *ends)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    arrow = "" if found["stronger"] == "more" else ", stronger to the right"
    axes.set_xlabel(f"{found['axis']}{arrow}")
    shams.set_xticks([0], ["no stress"])
    shams.set_xlim(-0.6, 0.6)
    shams.grid(visible=False, axis="x")
    shams.axhline(found["level"], color=GREY, linewidth=0.9, linestyle="--")
    shams.set_ylabel(f"probability of {found['failure_name']}")
    percent_axis(shams.yaxis)
    shams.set_yticks(np.linspace(0, 1, 5))
    shams.tick_params(axis="x", length=0)
    axes.tick_params(axis="y", length=0)
    title = "\n".join(textwrap.wrap(found["answer"], round(13 * width_in)))
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    columns = 5 if width_in > NARROW_IN else 2
    below = [line for text in searched for line in textwrap.wrap(text, round(17 * width_in))]
    # The legend, which lies at the very bottom too, takes the empty lines.
    below += [""] * (1 + len(_legend(found)) // columns) if below else []
    figure.supxlabel("\n".join(below), fontsize=7.5, x=0.01, ha="left", linespacing=1.4)
    figure.legend(handles=_legend(found), loc="outside lower right", ncols=columns, fontsize=8.5)
    return figure


def _draw_answer(axes: Axes, found: dict[str, Any]) -> None:
    """The level, the dose and its interval; an end that the doses do not bound lies at the edge."""
    axes.axhline(found["level"], color=GREY, linewidth=0.9, linestyle="--")
    weak, strong = ("low", "high") if found["stronger"] == "more" else ("high", "low")
    if found["dose"] is None:
        return
    ends = [found["weakest"] if found[weak] is None else found[weak]]
    ends.append(found["strongest"] if found[strong] is None else found[strong])
    axes.plot(ends, [found["level"]] * 2, color=ORANGE, linewidth=5, alpha=0.45, solid_capstyle="butt")
    axes.plot(found["dose"], found["level"], "D", color=ORANGE, markersize=8, zorder=4)


def _draw_trials(axes: Axes, trials: list[dict[str, Any]]) -> None:
    """A mark per trial: failures above 1, the others below 0, those of one dose in a pile."""
    judged = [(t["dose"] or 0.0, t["failed"]) for t in trials if t["failed"] is not None]
    most = max(Counter(judged).values(), default=1)
    piled: Counter[tuple[float, bool]] = Counter()
    for x, failed in judged:
        piled[x, failed] += 1
        row = min(_ROW, _PILE / most) * piled[x, failed]
        style = {"markerfacecolor": GREY} if failed else {"markerfacecolor": "white"}
        y = 1 + row if failed else -row
        axes.plot(x, y, "o", color=GREY, markersize=4.5, markeredgewidth=0.9, clip_on=False, **style)
    axes.axhspan(0, 1, color=PALE, alpha=0.12, linewidth=0)


def _legend(found: dict[str, Any]) -> list[Any]:
    mark = {"color": GREY, "marker": "o", "linestyle": "none", "markersize": 5}
    entries: list[Any] = [
        Line2D([], [], markerfacecolor=GREY, label="trial that fails", **mark),
        Line2D([], [], markerfacecolor="white", label="that does not", **mark),
        Line2D([], [], color=BLUE, label="probability"),
        Patch(color=BLUE, alpha=0.18, label="95 % band"),
    ]
    if found["dose"] is not None:
        label = f"dose of {100 * found['level']:g} %, interval"
        entries.append(Line2D([], [], color=ORANGE, marker="D", markersize=7, linewidth=4, label=label))
    return entries
