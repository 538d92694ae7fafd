"""Whether two events come in the same runs of a sequence, and whether in the same sequences; their counts."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import exp, inf, sqrt

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammaln

from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.from_records import HomogeneousCell
from dslab.experiments.statistics.outcomes import Floats
from dslab.experiments.statistics.world_intervals import Interval, student

_LEAST_WORLDS = 3
_HALF = 0.5
_FARTHEST = 12.0  # logarithm of the odds ratio from which it is unbounded


@dataclass(frozen=True)
class EventPair:
    """Two events over all cells; B has the number 0, the failure of thread j in the crossing arm j.

    Attributes:
        first, second: numbers of the events.
        telling: sequences of a cell in which both events happen in some runs and not in others.
        within: odds of one event in the runs of a sequence that have the other, over those in its other runs;
            1 if runs share no more than their sequence. None with telling sequences of under 3 worlds.
        across: the same between one run and another of the same sequence, within cells: what the sequence
            shares. None where one of the events happens always or never.
    """

    first: int
    second: int
    telling: int
    within: Interval | None
    across: Interval | None


@dataclass(frozen=True)
class Repeats:
    """Sequences of one cell by their runs with B and with a failure of one thread in the crossing arm.

    Attributes:
        cell, world: which one.
        thread: its number from 1.
        sequences: (K + 1, K + 1) their number, by runs with B and then with R_j; those of K counted runs.
    """

    cell: str
    world: str
    thread: int
    sequences: tuple[tuple[int, ...], ...]


def repeats(cells: Sequence[HomogeneousCell]) -> tuple[Repeats, ...]:
    """Count the sequences of every cell, by thread; cells without repeats are left out."""
    found = []
    for cell in (cell for cell in cells if cell.shape[2] > 1):
        for thread, failures in enumerate(cell.outcomes.thread_failures, 1):
            both = np.stack([cell.outcomes.breakage, failures])
            counts = both.sum(axis=-1).reshape(2, -1)  # NaN where a run does not count
            counts = counts[:, np.isfinite(counts).all(axis=0)].astype(int)
            table = np.zeros((cell.shape[2] + 1,) * 2, int)
            np.add.at(table, tuple(counts), 1)
            if table.any():
                found.append(Repeats(cell.name, cell.world, thread, tuple(map(tuple, table.tolist()))))
    return tuple(found)


def event_pairs(cells: Sequence[HomogeneousCell]) -> tuple[EventPair, ...]:
    """Every pair of B and the threads' failures, over all cells; none without repeats."""
    if not any(cell.shape[2] > 1 for cell in cells):
        return ()
    numbers = range(1 + min(cell.threads for cell in cells))
    return tuple(_pair(cells, first, second) for first, second in combinations(numbers, 2))


def _pair(cells: Sequence[HomogeneousCell], first: int, second: int) -> EventPair:
    place = {w: i for i, w in enumerate(dict.fromkeys(w for cell in cells for w in cell.outcomes.worlds))}
    within, worlds, across = [], [], np.zeros((len(cells), len(place), 4))
    for i, outcomes in enumerate(cell.outcomes for cell in cells):
        x, y = outcomes.columns[[first, second]]
        at = np.array([place[world] for world in outcomes.worlds])
        within.append(same_run(x, y).reshape(-1, 4))
        worlds.append(np.repeat(at, x.shape[1]))
        across[i, at] = _other_run(x, y).sum(axis=1)
    tables = np.concatenate(within)
    return EventPair(
        first,
        second,
        int(_tells(tables).sum()),
        conditional_odds_ratio(tables, np.concatenate(worlds)),
        odds_ratio_over_cells(across),
    )


def conditional_odds_ratio(tables: Floats, worlds: np.ndarray) -> Interval | None:
    """Odds ratio common to (strata, 4) tables, of greatest likelihood given the margins of each.

    A table counts the runs with both events, the first alone, the second alone, and neither. The interval
    holds the ratios whose score the data do not contradict. The score's variance is the likelihood's, times
    the dispersion between worlds where that is over 1.

    Args:
        tables: one per stratum.
        worlds: (strata,) the world of each, any integers.

    Returns:
        The ratio, 0 or infinite if all tables are as far from independence as their margins let them be; None
        with telling strata of fewer than 3 worlds.

    Source: Breslow & Day, "Statistical methods in cancer research I", 1980, ch. 7 (conditional likelihood of
    matched strata); the dispersion as for quasi-likelihood, McCullagh & Nelder 1989, ch. 9.
    """
    known = _tells(tables)
    tables, names = tables[known], np.unique(worlds[known])
    if len(names) < _LEAST_WORLDS:
        return None
    world = np.searchsorted(names, worlds[known])
    value = _root(lambda log: float(_score(tables, log)[0].sum()))
    dispersion = 1.0
    if abs(value) < _FARTHEST:
        score, variance = _score(tables, value)
        dispersion = max(1.0, float((np.bincount(world, score) ** 2).sum() / variance.sum()))
    z2 = student(len(names) - 1) ** 2

    def beyond(log: float, sign: int) -> float:
        score, variance = (part.sum() for part in _score(tables, log))
        return float(score + sign * sqrt(z2 * dispersion * variance))

    low, high = (_root(lambda log, sign=sign: beyond(log, sign)) for sign in (-1, 1))
    return Interval(*(_exp(log) for log in (value, min(low, value), max(high, value))))


def odds_ratio_over_cells(tables: Floats) -> Interval | None:
    """Odds ratio common to cells, of (cells, worlds, 4) counts as in `conditional_odds_ratio`.

    Half a run is added to each of the four of a cell. A cell in which an event happens always or never tells
    nothing; None if all are such, or with fewer than 3 worlds.

    Source: Mantel & Haenszel 1959; Haldane 1956 for the half; Robins, Breslow & Greenland 1986 for the least
    variance; the jackknife over worlds.
    """
    tables = tables[_tells(tables.sum(axis=1))]
    tables = tables[:, tables.sum(axis=(0, 2)) > 0]
    if tables.shape[1] < _LEAST_WORLDS or not len(tables):
        return None
    total = tables.sum(axis=1) + _HALF
    log = Figure(float(_log_ratio(total)), _log_ratio(total[:, None] - tables))
    error = max(log.error, sqrt(_least_variance(total)))
    half = student(log.worlds - 1) * error
    return Interval(*(exp(log.value + sign * half) for sign in (0, -1, 1)))


def same_run(x: Floats, y: Floats) -> Floats:
    """(W, S, 4) runs by which of two events, (W, S, K), they have."""
    each = np.stack([x * y, x * (1 - y), (1 - x) * y, (1 - x) * (1 - y)], axis=-1)
    return np.nansum(each, axis=2)


def _other_run(x: Floats, y: Floats) -> Floats:
    """(W, S, 4) the same of one run's first event and another run's second, scaled to the number of runs."""
    runs = np.isfinite(x + y).sum(axis=2)[..., None]
    of_x, of_y = (np.where(np.isfinite(x + y), each, np.nan) for each in (x, y))
    one, other = (np.stack([np.nansum(e, axis=2), np.nansum(1 - e, axis=2)], axis=-1) for e in (of_x, of_y))
    pairs = (one[..., :, None] * other[..., None, :]).reshape(*runs.shape[:2], 4)
    return np.where(runs > 1, (pairs - same_run(x, y)) / np.maximum(runs - 1, 1), 0.0)


def _tells(tables: Floats) -> np.ndarray:
    """True for tables in which neither event happens always or never."""
    both, first, second, neither = np.moveaxis(tables, -1, 0)
    return np.minimum.reduce([both + first, both + second, first + neither, second + neither]) > 0


def _score(tables: Floats, log: float) -> tuple[Floats, Floats]:
    """(strata,) runs with both events minus their mean given the margins, and the variance of that."""
    both, first, second, neither = (column[:, None] for column in tables.T)
    runs = np.arange(tables.sum(axis=1).max() + 1)[None]
    table = np.stack([runs + 0 * both, both + first - runs, both + second - runs, neither - both + runs])
    possible = (table >= 0).all(axis=0)
    weight = np.where(possible, runs * log - gammaln(np.maximum(table, 0) + 1).sum(axis=0), -inf)
    chance = np.exp(weight - weight.max(axis=1, keepdims=True))
    chance /= chance.sum(axis=1, keepdims=True)
    mean = (chance * runs).sum(axis=1)
    return both[:, 0] - mean, (chance * (runs - mean[:, None]) ** 2).sum(axis=1)


def _root(falling) -> float:
    """Where a falling function of the logarithm is 0, or the end of the range where it has none."""
    if falling(-_FARTHEST) <= 0:
        return -_FARTHEST
    return _FARTHEST if falling(_FARTHEST) >= 0 else float(brentq(falling, -_FARTHEST, _FARTHEST))


def _exp(log: float) -> float:
    return inf if log >= _FARTHEST else 0.0 if log <= -_FARTHEST else exp(log)


def _products(tables: Floats) -> tuple[Floats, Floats]:
    both, first, second, neither = np.moveaxis(tables, -1, 0)
    total = tables.sum(axis=-1)
    return both * neither / total, first * second / total


def _log_ratio(tables: Floats) -> Floats:
    """Logarithm of Mantel-Haenszel's ratio over the first axis."""
    alike, unlike = _products(tables)
    return np.log(alike.sum(axis=0)) - np.log(unlike.sum(axis=0))


def _least_variance(tables: Floats) -> float:
    """Variance of that logarithm if all runs were independent."""
    alike, unlike = _products(tables)
    r, s, total = alike.sum(), unlike.sum(), tables.sum(axis=-1)
    p, q = (tables[:, 0] + tables[:, 3]) / total, (tables[:, 1] + tables[:, 2]) / total
    mixed = (p * unlike + q * alike).sum() / (r * s)
    return float(((p * alike).sum() / r**2 + mixed + (q * unlike).sum() / s**2) / 2)
