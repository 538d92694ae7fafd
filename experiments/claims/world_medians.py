"""Medians over worlds, and how they are printed and drawn."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from dslab.experiments.statistics.world_intervals import median_interval


def over_worlds(rows: pd.DataFrame, name: str) -> dict[str, Any] | None:
    """Median over worlds, its interval, and how many worlds have the figure; None if none has."""
    by_world = rows.groupby("world")[name].median().dropna().to_numpy()
    return {**vars(median_interval(by_world)), "worlds": len(by_world)} if len(by_world) else None


def shown(interval: dict[str, Any] | None, ends: bool = True) -> str:
    """A figure in three digits, with the ends of its interval unless they are unbounded or not wanted."""
    if interval is None:
        return "-"
    value, low, high = (f"{interval[name]:#.3g}" for name in ("value", "low", "high"))
    bounded = np.isfinite([interval["low"], interval["high"]]).all()
    return f"{value} ({low} to {high})" if ends and bounded else value


def draw_over(
    axes: Axes,
    points: Sequence[tuple[float, dict[str, Any] | None]],
    colour: str,
    line: str = "-",
    mark: str = "o",
    ends: bool = True,
) -> None:
    """Draw figures over numbers as a line; a vertical one for every interval that is bounded, if wanted."""
    known = [(x, figure) for x, figure in points if figure]
    values = [figure["value"] for _, figure in known]
    axes.plot([x for x, _ in known], values, line, marker=mark, color=colour, markersize=3, linewidth=1.2)
    for x, figure in known if ends else ():
        low, high = figure["low"], figure["high"]
        if low is not None and high is not None and np.isfinite([low, high]).all():
            axes.plot([x, x], [low, high], color=colour, linewidth=0.8)
