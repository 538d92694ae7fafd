"""Recovery threads beside each other, in the crossing arm, where all of them cross the same segment."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import exp, sqrt

import numpy as np
from scipy import stats

from dslab.experiments.eq1.records import thread_column
from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.from_records import HomogeneousCell
from dslab.experiments.statistics.judged import share_by_world, share_of_part
from dslab.experiments.statistics.outcomes import Floats
from dslab.experiments.statistics.world_intervals import Interval

_LEAST_WORLDS = 3
_HALF = 0.5


@dataclass(frozen=True)
class ThreadShares:
    """How often a thread fails in one cell of one kind of world.

    Attributes:
        cell, world: which one.
        thread: its number from 1.
        units: that every thread crossed.
        failed: R_j.
        rescuable: units whose views on either side of the stress share enough.
        failed_rescuable: R_j of these; None where the records do not say or there are none.
        needed: units in which all threads before it fail; all units for the first.
        adds: share of these that it crosses.
    """

    cell: str
    world: str
    thread: int
    units: int
    failed: Interval
    rescuable: int
    failed_rescuable: Interval | None
    needed: int
    adds: Interval | None


@dataclass(frozen=True)
class ThreadPair:
    """Whether two threads fail in the same units of one cell of one kind of world.

    Attributes:
        cell, world: which one.
        first, second: numbers of the threads.
        both, only_first, only_second, neither: units in which so many of the two fail.
        odds_ratio: odds that one fails where the other does, over those where it does not: 1 if they fail
            independently, more if in the same units, less if in others. None with fewer than three worlds, or
            if one of the two fails in all units or in none.
    """

    cell: str
    world: str
    first: int
    second: int
    both: int
    only_first: int
    only_second: int
    neither: int
    odds_ratio: Interval | None


def thread_shares(cells: Sequence[HomogeneousCell]) -> tuple[ThreadShares, ...]:
    """Shares of every thread, by cell and thread; cells without a crossing arm are left out."""
    return tuple(
        found
        for cell in cells
        if _crosses(cell)
        for thread in range(1, cell.threads + 1)
        if (found := _shares(cell, thread)) is not None
    )


def thread_pairs(cells: Sequence[HomogeneousCell]) -> tuple[ThreadPair, ...]:
    """Every pair of threads, by cell; cells without a crossing arm are left out."""
    return tuple(
        _pair(cell, first, second)
        for cell in cells
        if _crosses(cell)
        for first, second in combinations(range(1, cell.threads + 1), 2)
    )


def _crosses(cell: HomogeneousCell) -> bool:
    return cell.says(*(thread_column("cross", j, "failed") for j in range(1, cell.threads + 1)))


def _shares(cell: HomogeneousCell, thread: int) -> ThreadShares | None:
    failures = cell.outcomes.thread_failures
    failed, needed = failures[thread - 1], _product(failures[: thread - 1], failures[0])
    share = share_by_world(failed)
    if share is None:
        return None
    says = cell.says("rescuable")
    rescuable = cell.values("rescuable") if says else np.zeros_like(failed)
    return ThreadShares(
        cell=cell.name,
        world=cell.world,
        thread=thread,
        units=int(np.isfinite(failed).sum()),
        failed=share,
        rescuable=int(np.nansum(rescuable)),
        failed_rescuable=share_of_part(failed, rescuable) if says else None,
        needed=int(np.nansum(needed)),
        adds=share_of_part(1 - failed, needed),
    )


def _product(columns: Floats, like: Floats) -> Floats:
    """Product over the first axis; 1 for none, NaN where there is no unit."""
    return np.where(np.isfinite(like), np.prod(columns, axis=0), np.nan)


def _pair(cell: HomogeneousCell, first: int, second: int) -> ThreadPair:
    one, other = (cell.outcomes.thread_failures[j - 1] for j in (first, second))
    events = [one * other, one * (1 - other), (1 - one) * other, (1 - one) * (1 - other)]
    both, only_first, only_second, neither = (int(np.nansum(event)) for event in events)
    return ThreadPair(
        cell=cell.name,
        world=cell.world,
        first=first,
        second=second,
        both=both,
        only_first=only_first,
        only_second=only_second,
        neither=neither,
        odds_ratio=_odds_ratio(np.stack([np.nansum(event, axis=(1, 2)) for event in events])),
    )


def _odds_ratio(by_world: Floats) -> Interval | None:
    """Odds ratio of (4, W) units per world, half a unit added to each of the four; its interval by worlds.

    Its variance is at least that of as many independent units. None unless each thread fails in some units
    and crosses others.

    Source: Haldane 1956 for the half, Woolf 1955 for the least variance; the jackknife over worlds.
    """
    by_world = by_world[:, by_world.sum(axis=0) > 0]
    worlds, total = by_world.shape[1], by_world.sum(axis=1)
    both, first, second, neither = total
    if worlds < _LEAST_WORLDS or min(both + first, both + second, first + neither, second + neither) == 0:
        return None
    figure = Figure(_log_odds(total), np.array([_log_odds(total - world) for world in by_world.T]))
    variance = max(float(np.var(figure.pseudo_values, ddof=1)) / worlds, float((1 / (total + _HALF)).sum()))
    half = float(stats.t.ppf(0.975, worlds - 1)) * sqrt(variance)
    return Interval(*(exp(figure.value + sign * half) for sign in (0, -1, 1)))


def _log_odds(units: Floats) -> float:
    both, first, second, neither = np.log(units + _HALF)
    return float(both + neither - first - second)
