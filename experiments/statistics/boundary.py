"""The boundary of a stress: the dose at which a failure has a given probability, from single trials.

P = g + (a - g) logistic(s (u - x)): u the strength of a dose (its logarithm, or minus that where less is
stronger), x the middle of the rise, s its slope, g the sham rate, a the ceiling. The posterior of all four
lies on a grid; doses are chosen by the information that their outcomes are expected to give.

Source: Watson & Pelli, "QUEST", Percept. Psychophys. 1983 (doses by Bayes); Kontsevich & Tyler, "Bayesian
adaptive estimation of psychometric slope and threshold", Vision Res. 1999 (expected information); Prins, "The
psi-marginal adaptive method", J. Vision 2013, and Watson, "QUEST+", J. Vision 2017 (lapses, here the ceiling,
among the parameters).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CEILINGS = (0.5, 0.7, 0.9, 1.0)
"""a: the probability that no dose exceeds."""
SHAM_RATES = (0.0, 0.02, 0.05, 0.1, 0.2, 0.4)
"""g: the probability without stress."""
SLOPES = tuple(np.geomspace(0.7, 16.0, 8).tolist())
"""s, per unit of strength: from 10 to 90 % in a factor of e^(4.4/s) of the dose, 500 to 1.3."""
SHAM = -1
"""Place of a sham trial among the doses."""
CONFIDENCE = 0.95
_QUANTILES = (0.5, (1.0 - CONFIDENCE) / 2, 1.0 - (1.0 - CONFIDENCE) / 2)
MOST_AT_ONCE = 8
"""Doses that are chosen together at most: all their outcomes are weighed."""
_MIDDLES = 81
_BEYOND = 0.25
"""The middle may lie outside the doses by this share of their range."""
_TINY = 1e-12
_NEGLIGIBLE = 1e-8
"""Curves that are less probable than this share of the likeliest one do not bear on a choice."""


@dataclass(frozen=True)
class Boundary:
    """The strength at which the probability of failure is ``level``, from the posterior.

    Attributes:
        level: probability of failure.
        median: posterior median; infinite if no dose reaches the level, minus infinite if the sham does.
        low, high: ends of the interval of CONFIDENCE, equal tails; likewise.
        unreachable: posterior probability that the ceiling is not above the level.
        sham_rate: posterior mean of g.
    """

    level: float
    median: float
    low: float
    high: float
    unreachable: float
    sham_rate: float


class Curves:
    """Curves of the probability of failure over strength.

    Args:
        middles, slopes, ceilings, sham_rates: x, s, a and g of each, (G,) or of a single one.
    """

    def __init__(
        self,
        middles: Floats | float,
        slopes: Floats | float,
        ceilings: Floats | float = 1.0,
        sham_rates: Floats | float = 0.0,
    ) -> None:
        self.middles, self.slopes, self.ceilings, self.sham_rates = middles, slopes, ceilings, sham_rates

    def failure(self, strength: float | Floats) -> Floats:
        """(..., G) probability of failure by every curve, at strengths of any shape."""
        u = np.asarray(strength, dtype=float)[..., None]
        rise = 0.5 * (1.0 + np.tanh(0.5 * self.slopes * (u - self.middles)))
        return self.sham_rates + (self.ceilings - self.sham_rates) * rise

    def reaching(self, level: float) -> Floats:
        """(G,) strength at which every curve reaches a probability; infinite if its ceiling is not above."""
        above = np.maximum(self.ceilings - level, _TINY)
        risen = np.maximum(level - self.sham_rates, _TINY)
        found = self.middles + np.log(risen / above) / self.slopes
        found = np.where(self.sham_rates >= level, -inf, found)
        return np.where(self.ceilings <= level, inf, found)


class CurveGrid(Curves):
    """Every curve of the grid, and what trials say of them.

    Args:
        strengths: (D,) of the doses, ascending, at least two.
    """

    def __init__(self, strengths: Sequence[float]) -> None:
        self.strengths = np.asarray(strengths, dtype=float)
        low, high = self.strengths[0], self.strengths[-1]
        beyond = _BEYOND * (high - low)
        axes = np.linspace(low - beyond, high + beyond, _MIDDLES), SLOPES, CEILINGS, SHAM_RATES
        super().__init__(*(axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")))

    def posterior(self, places: Sequence[int], failed: Sequence[bool]) -> Floats:
        """(G,) probability of every curve after trials; all are alike before.

        Args:
            places: per trial the number of its dose, or SHAM.
            failed: per trial.
        """
        counts = np.zeros((2, len(self.strengths) + 1))
        for place, outcome in zip(places, failed, strict=True):
            counts[int(outcome), place] += 1  # SHAM is the last
        log = np.einsum("ij,ijg->g", counts, self._logs)
        weights = np.exp(log - log.max())
        return np.asarray(weights / weights.sum())

    def choose(self, weights: Floats, count: int) -> list[int]:
        """The numbers of the doses of the next trials, all of which run before the next choice.

        Each is the one that adds most to what the outcomes together are expected to tell of the curve: their
        entropy, less the entropy that is left if the curve is known. Of equal ones it is the weakest.

        Args:
            weights: (G,) posterior.
            count: number of trials, MOST_AT_ONCE at most.
        """
        kept = weights > _NEGLIGIBLE * weights.max()
        weights, failure = weights[kept], self._failure[:, kept]
        noise = self._entropy[:, kept] @ weights
        chosen: list[int] = []
        branches = weights[None]  # one row per combination of outcomes: its probability by each curve
        while len(chosen) < count:
            failing = branches @ failure.T
            passing = branches.sum(axis=1, keepdims=True) - failing
            gain = _plogp(failing).sum(axis=0) + _plogp(passing).sum(axis=0) - noise
            # Rounded: which of two equal doses is chosen must not depend on the order of sums.
            place = int(np.argmax(np.round(gain, 9)))
            chosen.append(place)
            p = failure[place]
            branches = np.concatenate([branches * p, branches * (1.0 - p)])
        return chosen

    def boundary(self, weights: Floats, level: float) -> Boundary:
        """The answer of a posterior for a level."""
        reaching = self.reaching(level)
        unreachable = float(weights[self.ceilings <= level].sum())
        of_level = (quantile(reaching, weights, q) for q in _QUANTILES)
        return Boundary(level, *of_level, unreachable, float(weights @ self.sham_rates))

    def curve(self, weights: Floats, strengths: Floats) -> Floats:
        """(3, N) median and ends of the interval of the probability of failure at (N,) strengths."""
        failure = (self.failure(u) for u in strengths)
        return np.array([[quantile(p, weights, q) for q in _QUANTILES] for p in failure]).T

    @cached_property
    def _failure(self) -> Floats:
        return self.failure(self.strengths)

    @cached_property
    def _logs(self) -> Floats:
        """(2, D + 1, G) log probability of passing and of failing, at the doses and in a sham."""
        failure = np.concatenate([self._failure, self.sham_rates[None]])
        return np.log(np.maximum([1.0 - failure, failure], _TINY))

    @cached_property
    def _entropy(self) -> Floats:
        return _plogp(self._failure) + _plogp(1.0 - self._failure)


@cache
def curve_grid(strengths: tuple[float, ...]) -> CurveGrid:
    """The grid of some doses, made once."""
    return CurveGrid(strengths)


def quantile(values: Floats, weights: Floats, share: float) -> float:
    """Weighted quantile of (G,) values, which may be infinite: between two finite ones in a straight line."""
    order = np.argsort(values, kind="stable")
    ordered, mass = values[order], weights[order]
    # Each value stands for the middle of its mass.
    upto = np.cumsum(mass) - 0.5 * mass
    at = int(np.searchsorted(upto, share))
    if at == 0 or at == len(ordered):
        return float(ordered[min(at, len(ordered) - 1)])
    before, after = float(ordered[at - 1]), float(ordered[at])
    if not (isfinite(before) and isfinite(after)):
        return before if share - upto[at - 1] < upto[at] - share else after
    return before + (after - before) * float((share - upto[at - 1]) / (upto[at] - upto[at - 1]))


def _plogp(p: Floats) -> Floats:
    """Terms of an entropy in nats, 0 for impossible outcomes."""
    return -p * np.log(np.maximum(p, _TINY))
