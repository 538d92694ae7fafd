"""Estimated paths over the true one (Fig. 8 of the paper)."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dslab.experiments.report.plots.style import (
    BLUE,
    GREEN,
    NARROW_IN,
    ORANGE,
    legend_above,
    panels,
    wrapped,
)

_COLUMNS = 3
_STYLES = {
    "truth": {"color": BLUE, "linewidth": 3.2, "alpha": 0.45, "label": "truth"},
    "base": {"color": ORANGE, "linewidth": 1.3, "linestyle": "--", "label": "base"},
    "dual": {"color": GREEN, "linewidth": 1.3, "label": "Dual-SLAM"},
}


def draw_paths(
    paths: dict[str, dict[str, np.ndarray]], names: dict[str, str], width_in: float
) -> Figure | None:
    """Draw a panel per unit, in the plane of the path's two longest axes.

    Args:
        paths: paths from `recordings.read_paths`.
        names: panel titles by unit id.
    """
    shown: list[tuple[str, dict[str, Any]]] = [(unit, own) for unit, own in paths.items() if "truth" in own]
    if not shown:
        return None
    figure, places = panels(len(shown), _COLUMNS, width_in, 2.8, 0.5)
    figure.set_figwidth(2.9 * min(_COLUMNS if width_in > NARROW_IN else 1, len(shown)))
    for axes, (unit, own) in zip(places, shown, strict=True):
        ground = np.sort(np.argsort(np.nanmax(own["truth"], 0) - np.nanmin(own["truth"], 0))[1:])
        for which, style in _STYLES.items():
            if which in own:
                axes.plot(*own[which][:, ground].T, **style)
        axes.set_title(wrapped(names.get(unit, unit), width_in), fontsize=9)
        axes.set_aspect("equal", adjustable="datalim")
        axes.tick_params(labelsize=7)
    places[0].set_ylabel("m")
    legend_above(figure, places[0].get_legend_handles_labels()[0], 3, width_in)
    return figure
