"""Curves and ticks over the time of a sequence."""

import math
from collections.abc import Iterator

import numpy as np

from dslab.experiments.gallery.plan_map import height_range_m, svg_points
from dslab.experiments.gallery.sheet import Sheet
from dslab.scenarios.describe import measured

WIDTH, HEIGHT = 1000.0, 36.0
"""Size of a curve's box in its own units."""

_MOST_TICKS = 8
_NEAR_THE_END = 0.94


def curves(sheet: Sheet) -> dict[str, str]:
    """SVG points of speed, angular rate and, for a climb, height, by label."""
    track = sheet.track
    found = {
        f"speed, to {measured(track.speed_mps.max())} m/s": _points(track.stamps_s, track.speed_mps, 0.0),
        f"rate, to {measured(track.rate_degps.max())} °/s": _points(track.stamps_s, track.rate_degps, 0.0),
    }
    if heights_m := height_range_m(sheet):
        low, high = heights_m
        found[f"height, {measured(low)} to {measured(high)} m"] = _points(
            track.stamps_s, track.position_m[:, 2], low
        )
    return found


def _points(stamps_s: np.ndarray, values: np.ndarray, base: float) -> str:
    """A line that fills its box from ``base`` to its highest value."""
    span = max(float(values.max()) - base, 1e-9)
    x = WIDTH * stamps_s / stamps_s[-1]
    y = HEIGHT - 1 - (HEIGHT - 2) * (values - base) / span
    # The highest value of every four units: finer detail would not be visible.
    columns = np.unique((x / 4).astype(int), return_index=True)[1]
    return svg_points(np.column_stack([x[columns], np.minimum.reduceat(y, columns)]))


def ticks(duration_s: float) -> Iterator[tuple[float, str]]:
    """Time and CSS class of each tick."""
    power = 10 ** math.floor(math.log10(duration_s / _MOST_TICKS))
    step_s = next(f * power for f in (1, 2, 5, 10) if f * power * _MOST_TICKS >= duration_s)
    for stamp_s in np.arange(0, duration_s + 1e-9, step_s):
        # The first and a last one near the end are shifted into the axis.
        yield stamp_s, "first" if stamp_s == 0 else "last" if stamp_s > _NEAR_THE_END * duration_s else ""
