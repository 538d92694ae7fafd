"""Dependence of forward and backward failures: two-by-two tables of paired units."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binomtest, fisher_exact
from statsmodels.stats.contingency_tables import StratifiedTable

from experiments.statistics.joint import Bools, Floats
from experiments.statistics.results import Estimate

_LIMITS = "limits of posterior draws, a unit's worth of prior on their own side"


@dataclass(frozen=True)
class PairedCounts:
    """Units counted by A and R."""

    both: int
    only_a: int
    only_r: int
    neither: int

    @classmethod
    def of_units(cls, a: Bools, r: Bools) -> "PairedCounts":
        """Count units from (N,) A and (N,) R."""
        return cls(int((a & r).sum()), int((a & ~r).sum()), int((~a & r).sum()), int((~a & ~r).sum()))

    @property
    def units(self) -> int:
        """Number of units."""
        return self.both + self.only_a + self.only_r + self.neither

    @property
    def table(self) -> list[list[int]]:
        """Rows A, not A; columns R, not R."""
        return [[self.both, self.only_a], [self.only_r, self.neither]]


def conditional_ratio(
    counts: PairedCounts, draws: int, rng: np.random.Generator, confidence: float = 0.95
) -> Estimate:
    """ρ = P(R | A) / P(R); 1 under independence, undetermined without A or without R."""
    method = f"P(R | A) / P(R); {_LIMITS}"
    if counts.both + counts.only_a == 0 or counts.both + counts.only_r == 0:
        return Estimate.undetermined(method)
    return _with_limits(_ratio, counts, draws, rng, confidence, method)


def phi(counts: PairedCounts, draws: int, rng: np.random.Generator, confidence: float = 0.95) -> Estimate:
    """Correlation of A and R; undetermined if one of them always or never happened."""
    method = f"phi; {_LIMITS}"
    table = np.array(counts.table)
    if 0 in (*table.sum(axis=0), *table.sum(axis=1)):
        return Estimate.undetermined(method)
    return _with_limits(_phi, counts, draws, rng, confidence, method)


def fisher(counts: PairedCounts) -> float | None:
    """Two-sided exact p of independence; None if A or R always or never happened."""
    table = np.array(counts.table)
    if 0 in (*table.sum(axis=0), *table.sum(axis=1)):
        return None
    return float(fisher_exact(table).pvalue)


def mcnemar(counts: PairedCounts) -> float | None:
    """Two-sided exact p of P(A) = P(R) on paired units; None without units, 1 if no pair differs."""
    if counts.units == 0:
        return None
    differing = counts.only_a + counts.only_r
    return float(binomtest(counts.only_a, differing).pvalue) if differing else 1.0


def mantel_haenszel(
    a: Bools, r: Bools, stratum: ArrayLike, confidence: float = 0.95
) -> tuple[Estimate, float | None]:
    """Common odds ratio of A and R within strata (worlds), and the p of independence within them.

    Only strata in which both A and R vary are informative; without one, all is undetermined. Overall
    dependence that vanishes within worlds comes from the worlds' uneven difficulty.

    Source: Mantel & Haenszel, J. National Cancer Institute 1959.
    """
    method = "Mantel–Haenszel odds ratio within worlds"
    _, index = np.unique(np.asarray(stratum), return_inverse=True)
    tables = np.zeros((int(index.max()) + 1 if index.size else 0, 2, 2))
    np.add.at(tables, (index, (~a).astype(int), (~r).astype(int)), 1)
    rows, columns = tables.sum(axis=2), tables.sum(axis=1)
    informative = tables[(rows.min(axis=1) > 0) & (columns.min(axis=1) > 0)] if len(tables) else tables
    if len(informative) == 0:
        return Estimate.undetermined(method), None
    found = StratifiedTable(np.moveaxis(informative, 0, -1))
    with np.errstate(all="ignore"):
        p = float(found.test_null_odds(correction=False).pvalue)
        value = float(found.oddsratio_pooled)
        low, high = found.oddsratio_pooled_confint(1 - confidence)
    bounded = math.isfinite(value) and value > 0 and math.isfinite(low) and math.isfinite(high)
    return (
        Estimate(
            value if math.isfinite(value) else None,
            float(low) if bounded else None,
            float(high) if bounded else None,
            method,
        ),
        p if math.isfinite(p) else None,
    )


def _with_limits(
    figure: Callable[[Floats], Floats],
    counts: PairedCounts,
    draws: int,
    rng: np.random.Generator,
    confidence: float,
    method: str,
) -> Estimate:
    """A figure of the counts; its limits are posterior quantiles, with one further unit as the prior.

    That unit speaks against a positive association for the lower limit, for one for the upper limit; as in
    `eq1.posterior_draws` they enclose the figure.
    """
    cells = np.array([counts.both, counts.only_a, counts.only_r, counts.neither], float)
    tails = (1 - confidence) / 2, (1 + confidence) / 2
    low, high = (
        float(np.quantile(figure(_draws(cells + prior, draws, rng)), tail))
        for prior, tail in zip(([0, 0.5, 0.5, 0], [0.5, 0, 0, 0.5]), tails, strict=True)
    )
    return Estimate(float(figure(cells[:, None])[0]), low, high, method)


def _draws(weights: Floats, draws: int, rng: np.random.Generator) -> Floats:
    return rng.standard_gamma(weights, (draws, 4)).T


def _ratio(cells: Floats) -> Floats:
    both, only_a, only_r, _ = cells
    return both * cells.sum(axis=0) / ((both + only_a) * (both + only_r))


def _phi(cells: Floats) -> Floats:
    both, only_a, only_r, neither = cells
    scale = (both + only_a) * (both + only_r) * (only_a + neither) * (only_r + neither)
    return (both * neither - only_a * only_r) / np.sqrt(scale)
