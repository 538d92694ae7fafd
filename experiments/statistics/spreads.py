"""Means over repeated runs with their intervals: the one method of comparisons and batches."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import inf, sqrt
from typing import Literal

import numpy as np

from dslab.experiments.statistics.world_intervals import share_interval, student, wilson_interval

Bounds = Literal["share", "amount", "event"]
"""A share is from 0 to 1, an amount from 0 up; an event is 0 or 1, or its share among several runs."""
ALIKE = "all alike"
"""Why repeats that are equal have no interval."""
SAME = 1e-6
"""Values that differ by less, relative to the largest, are equal: what rounding leaves of a map adjusted."""


@dataclass(frozen=True)
class Spread:
    """A mean over runs.

    Attributes:
        mean: None without a value.
        low, high: ends of its interval of 95 %; None where there is none.
        reason: why not: no run or one has the figure, or all runs are alike; empty if there is one.
        values: of all runs, None where one lacks the figure.
    """

    mean: float | None
    low: float | None
    high: float | None
    reason: str
    values: list[float | None]


def spread_of(values: Iterable[float | None], bounds: Bounds) -> Spread:
    """Mean of a figure over runs, with the interval of 95 % that its spread gives.

    Repeats that are all alike have no spread, which says nothing of other ones: there is no interval then,
    but for events, whose spread follows from their share.

    Args:
        values: of each run, None where it lacks the figure.
        bounds: of the figure. The interval of a share is Wilson's, with as many trials as the spread of the
            values is worth, p (1 - p) / error²; trials that have an event or not are counted. That of an
            amount is Student's, cut at 0, which no mean of amounts is below. None leaves the bounds.

    Source: Wilson 1927; trials as in Korn and Graubard 1998, "Confidence intervals for proportions with small
        expected number of positive counts estimated from survey data", there by the design effect.
    """
    kept = [None if value is None or np.isnan(value) else float(value) for value in values]
    known = np.array([value for value in kept if value is not None])
    if not len(known):
        return Spread(None, None, None, "no run", kept)
    mean = float(known.mean())
    if len(known) == 1:
        return Spread(mean, None, None, "one run", kept)
    if bounds != "event" and float(np.ptp(known)) <= SAME * float(np.abs(known).max()):
        return Spread(mean, None, None, ALIKE, kept)
    if bounds == "event" and set(known) <= {0.0, 1.0}:
        found = wilson_interval(mean, len(known), inf)
        return Spread(mean, found.low, found.high, "", kept)
    if bounds != "amount":
        found = share_interval(np.clip(known, 0.0, 1.0))
        return Spread(mean, found.low, found.high, "", kept)
    half = student(len(known) - 1) * float(known.std(ddof=1)) / sqrt(len(known))
    return Spread(mean, max(0.0, mean - half), mean + half, "", kept)
