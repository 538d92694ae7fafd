"""Medians over worlds, and how they are printed."""

from typing import Any

import numpy as np
import pandas as pd

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
