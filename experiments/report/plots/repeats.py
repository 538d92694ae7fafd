"""Plot of sequences by their runs that break and that a thread fails to cross."""

import textwrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dslab.experiments.report.conditions import thread_names
from dslab.experiments.report.plots.style import NARROW_IN, new_figure

_MOST_THREADS = 2
_COLUMNS = 4
_TITLE = 25  # characters


def draw_repeats(report: dict[str, Any], width_in: float) -> Figure | None:
    """Draw a grid per condition and thread; a square has its number of sequences, dark by share."""
    found = [r for r in report["analysis"]["repeats"] if r["thread"] <= _MOST_THREADS]
    if not found:
        return None
    named = {condition["cell"]: condition for condition in report["conditions"]}
    threads = thread_names(report)
    columns = min(_COLUMNS if width_in > NARROW_IN else 2, len(found))
    rows = -(-len(found) // columns)
    figure = new_figure(0.3 + rows * (0.65 + 0.75 * width_in / columns), width_in)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, grid in zip(panels, found, strict=False):
        _draw_grid(axes, np.array(grid["sequences"]))
        condition = named[grid["cell"]]
        name = f"{condition['number']}. {condition['name']}"
        axes.set_title(textwrap.fill(name, _TITLE), fontsize=7, loc="left")
        axes.set_ylabel(f"{threads[grid['thread'] - 1]} fails", fontsize=8)
        axes.set_xlabel("breaks", fontsize=8)
    for empty in panels[len(found) :]:
        empty.remove()
    return figure


def _draw_grid(axes: Axes, sequences: np.ndarray) -> None:
    """One square per number of runs that break, to the right, and that the thread fails to cross, upwards."""
    share = sequences / sequences.sum()
    axes.imshow(share.T, origin="lower", cmap="Blues", vmin=0, vmax=0.6)
    for (broke, failed), number in np.ndenumerate(sequences):
        if number:
            colour = "white" if share[broke, failed] > 0.3 else "#222222"
            axes.text(broke, failed, str(number), ha="center", va="center", fontsize=8, color=colour)
    runs = range(len(sequences))
    axes.set_xticks(runs, [str(k) for k in runs], fontsize=7)
    axes.set_yticks(runs, [str(k) for k in runs], fontsize=7)
    axes.grid(visible=False)
