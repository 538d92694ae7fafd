"""Correlation of difficulties: a probit model in which every sequence is easy or hard for each event.

In a run of a sequence event e happens with probability Phi((Phi^-1(p_e) + sqrt(r_e) d_e) / sqrt(1 - r_e)):
p_e is its share over all sequences, d_e the sequence's difficulty, standard normal, and r_e the part of the
spread that it makes. The difficulties of two events have the correlation rho; runs share nothing beyond them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import sqrt

import numpy as np
from scipy import stats
from scipy.optimize import brentq, minimize, minimize_scalar
from scipy.special import comb, ndtr, ndtri

from dslab.experiments.statistics.outcomes import Floats
from dslab.experiments.statistics.world_intervals import Interval, student

# Equal steps: Gauss-Hermite nodes lie too far apart for sequences that nearly always or never fail.
NODES = np.linspace(-6, 6, 121)
WEIGHTS = stats.norm.pdf(NODES) / stats.norm.pdf(NODES).sum()
_MOST = 0.99  # r; beyond it a step of the nodes is wider than the rise of the probability
_LEAST = 1e-4
_TOLERANCE = {"xatol": 1e-3, "fatol": 1e-6, "maxiter": 2000}


@dataclass(frozen=True)
class Margin:
    """One event.

    Attributes:
        share: p, over all sequences.
        difficulty: r, in [0, 1]: 0 if all sequences are alike, 1 if each fails always or never.
    """

    share: float
    difficulty: float

    def in_runs(self, difficulties: Floats) -> Floats:
        """Probability of the event in a run of sequences of such difficulties."""
        return ndtr((ndtri(self.share) + sqrt(self.difficulty) * difficulties) / sqrt(1 - self.difficulty))


@dataclass(frozen=True)
class Counts:
    """Of how many runs of a sequence have each event, and how many sequences are like that.

    Attributes:
        events: (rows, events) runs with each event.
        runs: (rows,) runs.
        sequences: (rows,) number of sequences.
    """

    events: np.ndarray
    runs: np.ndarray
    sequences: np.ndarray

    @classmethod
    def of(cls, columns: Floats) -> "Counts":
        """Count outcomes (events, W, S, K), NaN for void runs, of which a sequence needs one."""
        valid = np.isfinite(columns).all(axis=0)
        counts = np.where(valid, columns, 0).sum(axis=-1).reshape(len(columns), -1)
        rows = np.concatenate([counts, valid.sum(axis=-1).reshape(1, -1)]).T.astype(int)
        rows, sequences = np.unique(rows[rows[:, -1] > 0], axis=0, return_counts=True)
        return cls(rows[:, :-1], rows[:, -1], sequences)

    def only(self, *events: int) -> "Counts":
        """The same of some events alone."""
        return Counts(self.events[:, list(events)], self.runs, self.sequences)


def log_likelihood(counts: Counts, margins: Sequence[Margin], correlation: float) -> float:
    """Logarithm of the likelihood of counts, with one correlation in [0, 1] of all difficulties.

    Of two events it may be negative, in [-1, 1].
    """
    chance = WEIGHTS @ np.prod(
        [_given_common(counts, event, m, correlation) for event, m in enumerate(margins)], axis=0
    )
    return float((counts.sequences * np.log(np.maximum(chance, 1e-300))).sum())


def _given_common(counts: Counts, event: int, margin: Margin, correlation: float) -> Floats:
    """(nodes, rows) chance of the counts of one event, given what is common of their difficulties."""
    p, k = margin.in_runs(NODES)[:, None], counts.events[:, event]
    alone = comb(counts.runs, k) * p**k * (1 - p) ** (counts.runs - k)
    turned = correlation < 0 and event > 0
    return smoothing(abs(correlation)) @ (alone[::-1] if turned else alone)


@lru_cache(maxsize=64)
def smoothing(correlation: float) -> Floats:
    """(nodes, nodes) weights of an event's difficulties by that part: normal, of variance 1 - correlation."""
    away = (NODES - sqrt(correlation) * NODES[:, None]) ** 2
    # The nearest node stays in where all are far off, as without a difficulty of its own.
    weights = np.exp(-(away - away.min(axis=1, keepdims=True)) / (2 * max(1 - correlation, 1e-9)))
    return weights / weights.sum(axis=1, keepdims=True)


def fit_margin(counts: Counts) -> Margin:
    """Share and difficulty of one event, of greatest likelihood.

    Half a sequence with the event in all of its runs and half of one with it in none are added. Without
    repeats the difficulty is not known, and 0.
    """
    most = int(counts.runs.max())
    counts = Counts(
        np.append(counts.events[:, 0], [0, most])[:, None],
        np.append(counts.runs, [most, most]),
        np.append(counts.sequences, [0.5, 0.5]),
    )
    if most < 2:
        return Margin(float(np.average(counts.events[:, 0] > 0, weights=counts.sequences)), 0.0)
    found = minimize(
        lambda x: -log_likelihood(counts, [_margin(*x)], 0.0),
        (0, 0),
        method="Nelder-Mead",
        options=_TOLERANCE,
    )
    return _margin(*found.x)


def _margin(threshold: float, difficulty: float) -> Margin:
    """Margin from numbers without bounds."""
    share = float(ndtr(np.clip(threshold, -5, 5)))
    return Margin(share, _LEAST + (_MOST - _LEAST) * float(ndtr(np.clip(difficulty, -5, 5))))


def _numbers(margin: Margin) -> tuple[float, float]:
    return float(ndtri(margin.share)), float(
        ndtri(np.clip((margin.difficulty - _LEAST) / (_MOST - _LEAST), 1e-6, 1 - 1e-6))
    )


def correlation_of(counts: Counts) -> Interval | None:
    """Correlation of the difficulties of two events, in [-1, 1], with its interval by profile likelihood.

    Returns:
        None without repeats, or where an event happens always or never. An end is -1 or 1 where the data set
        no limit.

    Source: Eckhardt & Lee 1985 for difficulties; Student's t of the sequences for the level of the profile.
    """
    runs = (counts.sequences * counts.runs).sum()
    totals = (counts.sequences[:, None] * counts.events).sum(axis=0)
    if counts.runs.max() < 2 or (totals == 0).any() or (totals == runs).any():
        return None
    start = [number for event in (0, 1) for number in _numbers(fit_margin(counts.only(event)))]

    def loss(correlation: float) -> float:
        def of_margins(x: Floats) -> float:
            return -log_likelihood(counts, [_margin(*x[:2]), _margin(*x[2:])], correlation)

        return float(minimize(of_margins, start, method="Nelder-Mead", options=_TOLERANCE).fun)

    grid = np.linspace(-1, 1, 9)
    losses = [loss(correlation) for correlation in grid]
    i = int(np.argmin(losses))
    bounds = (grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)])
    found = minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": 2e-3})
    least, best = min((losses[i], float(grid[i])), (float(found.fun), float(found.x)))
    allowed = least + student(max(int(counts.sequences.sum()) - 1, 1)) ** 2 / 2

    def end(bound: float) -> float:
        if bound == best or loss(bound) <= allowed:
            return bound
        return float(brentq(lambda c: loss(c) - allowed, *sorted((best, bound)), xtol=2e-3))

    return Interval(best, end(-1.0), end(1.0))


def common_correlation(cells: Sequence[tuple[Counts, Sequence[Margin]]]) -> float:
    """One correlation in [0, 1] of all difficulties in all cells, of greatest likelihood, margins given."""

    def loss(correlation: float) -> float:
        return -sum(log_likelihood(counts, margins, correlation) for counts, margins in cells)

    found = minimize_scalar(loss, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-3})
    return float(min((0.0, float(found.x), 1.0), key=loss))


def predict(margins: Sequence[Margin], correlation: float) -> float:
    """Share of runs in which all events happen, by one correlation in [0, 1] of all difficulties."""
    return float(np.prod([_given_common(_ONE, 0, m, correlation)[:, 0] for m in margins], axis=0) @ WEIGHTS)


_ONE = Counts(np.ones((1, 1), int), np.ones(1, int), np.ones(1, int))


def draw(
    margins: Sequence[Margin], correlation: float, rng: np.random.Generator, shape: tuple[int, int, int]
) -> Floats:
    """Draw outcomes (events, W, S, K), of 0 and 1."""
    worlds, sequences, runs = shape
    common = rng.normal(size=(1, worlds, sequences))
    own = rng.normal(size=(len(margins), worlds, sequences))
    difficulties = sqrt(correlation) * common + sqrt(1 - correlation) * own
    p = np.stack([m.in_runs(d) for m, d in zip(margins, difficulties, strict=True)])
    return (rng.random((*p.shape, runs)) < p[..., None]).astype(float)
