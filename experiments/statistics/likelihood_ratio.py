"""Likelihood-ratio test of "Eq. 1 holds" by parametric bootstrap, and its power.

H0: P(D_n | B) = ratio · Π P(R_j), with ratio 1; p0 cancels on both sides. The statistic is the likelihood
ratio of the margins (D_n of the breakages, each R_j of all units). Both arms run on the same units, hence the
margins are dependent. The bootstrap draws whole units from distributions that satisfy H0 and have the
constrained estimates as margins: one keeps the observed pairing, one has independent arms. The test's p is
the larger of the two: with few units the pairing is uncertain, and either one alone would reject too often.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import xlog1py, xlogy

from experiments.statistics.joint import (
    Floats,
    JointCounts,
    Margins,
    draw_tables,
    independent,
    margins_of,
    raked,
)

_STEPS = 45
_TIE = 1e-9


def constrained_estimates(counts: Margins, ratio: float = 1.0) -> tuple[Floats, Floats]:
    """Maximum-likelihood P(D_n | B) and pr_j under P(D_n | B) = ratio · Π pr_j.

    With the multiplier λ they are (d - λ)/(b - λ) and (k_j + λ)/(N + λ); one falls and the other rises with
    λ, hence bisection.

    Returns:
        (M,) P(D_n | B), (M, n) pr_j.
    """
    low, high = -counts.crossings.min(axis=1), counts.failures.copy()
    for _ in range(_STEPS):
        middle = (low + high) / 2
        share, pr = _at(counts, middle)
        above = share > ratio * pr.prod(axis=1)
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    share, pr = _at(counts, high)
    # If every crossing failed, λ may end at -N: only the product of the pr_j is then determined.
    at_end = (counts.crossings >= counts.units[:, None]).all(axis=1) & (
        counts.units + high <= 1e-6 * counts.units
    )
    alike = (share / ratio) ** (1 / pr.shape[1])
    pr = np.where(at_end[:, None], np.minimum(alike, 1)[:, None], pr)
    return np.minimum(ratio * pr.prod(axis=1), 1), pr


def signed_root(counts: Margins, ratio: float = 1.0) -> Floats:
    """(M,) root of the likelihood-ratio statistic, with the sign of measured minus predicted.

    0 without a breakage, where the counts are not informative.
    """
    share, pr = constrained_estimates(counts, ratio)
    free_share = _divided(counts.failures, counts.breakages)
    free_pr = _divided(counts.crossings, counts.units[:, None])
    gain = _log_likelihood(counts.failures, counts.breakages, free_share)
    gain -= _log_likelihood(counts.failures, counts.breakages, share)
    units = np.broadcast_to(counts.units[:, None], counts.crossings.shape)
    gain += (
        _log_likelihood(counts.crossings, units, free_pr) - _log_likelihood(counts.crossings, units, pr)
    ).sum(axis=1)
    root = np.sqrt(2 * np.maximum(gain, 0)) * np.sign(free_share - ratio * free_pr.prod(axis=1))
    return np.where(counts.breakages > 0, root, 0.0)


@dataclass(frozen=True)
class Eq1Test:
    """The test in one cell.

    Attributes:
        statistic: of the data; None if they are not informative (no unit, no breakage, or no failure at all).
        p: of the test; None likewise.
        measured_above: measured P(D_n) is above Eq. 1's.
        null: (2, R) statistics under H0 by both bootstraps, rows sorted, at the crossing arm's own pr_j.
        alternative: (R,) statistics under the alternative ratio, at these pr_j.
    """

    statistic: float | None
    p: float | None
    measured_above: bool
    null: Floats
    alternative: Floats

    def power(self, alpha: float) -> float:
        """Probability of p <= alpha under the alternative with these units; 0 if not informative."""
        if self.null.size == 0:
            return 0.0
        return float(np.mean(_p_values(self.alternative, self.null) <= alpha))


def eq1_test(
    counts: JointCounts, replicates: int, rng: np.random.Generator, alternative_ratio: float = 2.0
) -> Eq1Test:
    """Test H0 in a cell and find its power against a ratio.

    If Π pr_j is over 1/ratio, no such ratio exists: the alternative is then 1/ratio.

    Args:
        counts: of the cell's completed units.
        replicates: experiments drawn under H0, and as many under the alternative.
        rng: of the draws.
        alternative_ratio: measured / predicted of the alternative, > 1.
    """
    observed = counts.margins
    units = int(observed.units[0])
    none = np.zeros((2, 0))
    if units == 0 or observed.breakages[0] == 0:
        return Eq1Test(None, None, False, none, none[0])
    if observed.failures[0] == 0 and observed.crossings[0].min() == 0:
        return Eq1Test(None, None, False, none, none[0])
    # The alternative is a ratio to the measured prediction: the constrained pr_j would follow a measured
    # excess upward, and so overstate the power where Eq. 1 fails.
    predicted = (observed.crossings + 0.5) / (observed.units[:, None] + 1)
    share = predicted.prod(axis=1)
    factor = alternative_ratio if share[0] * alternative_ratio <= 1 else 1 / alternative_ratio
    models = [
        *_null_models(counts, *constrained_estimates(observed)),
        *_null_models(counts, share, predicted),
        raked(counts.table, _states(observed, share * factor), predicted[0]),
    ]
    drawn = [draw_tables(rng, model, units, replicates) for model in models]
    roots = signed_root(margins_of(np.concatenate([counts.table[None], *drawn])))
    batches = np.abs(roots[1:]).reshape(len(models), replicates)
    p = float(_p_values(np.abs(roots[:1]), np.sort(batches[:2], axis=1))[0])
    null, alternative = np.sort(batches[2:4], axis=1), batches[4]
    return Eq1Test(float(roots[0] ** 2), p, bool(roots[0] > 0), null, alternative)


def one_sided_p(
    counts: JointCounts, ratio: float, above: bool, replicates: int, rng: np.random.Generator
) -> float:
    """The p of H0 "the true ratio is at least (above: at most) this one" by the same bootstrap.

    Args:
        counts: of the cell; at least one breakage.
        ratio: at the edge of H0.
        above: the alternative is a larger ratio, else a smaller one.
        replicates: drawn at the edge.
        rng: of the draws.
    """
    sign = 1.0 if above else -1.0
    observed = counts.margins
    models = _null_models(counts, *constrained_estimates(observed, ratio))
    drawn = [draw_tables(rng, model, int(observed.units[0]), replicates) for model in models]
    roots = sign * signed_root(margins_of(np.concatenate([counts.table[None], *drawn])), ratio)
    return float(_p_values(roots[:1], np.sort(roots[1:].reshape(2, replicates), axis=1))[0])


def _null_models(counts: JointCounts, share: Floats, pr: Floats) -> tuple[Floats, Floats]:
    """Distributions of units with these margins: paired as observed, and independent."""
    states = _states(counts.margins, share)
    return raked(counts.table, states, pr[0]), independent(states, pr[0])


def _states(observed: Margins, share: Floats) -> Floats:
    """(3,) probabilities of the free arm's states at this P(D_n | B)."""
    p0 = observed.breakages / observed.units
    return np.concatenate([1 - p0, p0 * (1 - share), p0 * share])


def _p_values(statistics: Floats, null: Floats) -> Floats:
    """Share of the null at least as large, the observation included; the larger of both rows."""
    replicates = null.shape[1]
    larger = [replicates - np.searchsorted(row, statistics - _TIE, side="left") for row in null]
    return (1 + np.max(larger, axis=0)) / (1 + replicates)


def _at(counts: Margins, multiplier: Floats) -> tuple[Floats, Floats]:
    share = _divided(counts.failures - multiplier, counts.breakages - multiplier)
    pr = _divided(counts.crossings + multiplier[:, None], (counts.units + multiplier)[:, None])
    return np.clip(share, 0, 1), np.clip(pr, 0, 1)


def _divided(part: Floats, whole: Floats) -> Floats:
    whole = np.broadcast_to(whole, part.shape)
    return np.divide(part, whole, out=np.zeros(part.shape), where=whole > 0)


def _log_likelihood(events: Floats, units: Floats, p: Floats) -> Floats:
    return xlogy(events, p) + xlog1py(units - events, -p)
