"""What is concluded on Eq. 1: tests of one cell and list of threads, and the first verdict that applies.

Independence, on Q, is the primary test: permutations hold at any shares and any correlation within worlds.
The forecast, on D, comes second: it is a t-test, and untested where too few worlds have the event.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import prod

import numpy as np
from scipy import stats

from dslab.experiments.statistics import estimates
from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.outcomes import Floats, Outcomes, world_means
from dslab.experiments.statistics.permutations import PermutationTest
from dslab.experiments.statistics.world_intervals import FEW, few_events, t_of_log_ratio

LEVEL = 0.05
_LEAST_WORLDS = 10  # with the event, to be tested
_LEAST_ROOM = 1.25  # between the weakest link and Eq. 1
_MARGIN = 0.3  # of the way from Eq. 1 to the weakest link


class Verdict(StrEnum):
    """Eq. 1 in one cell; the first that applies."""

    UNTESTED = "untested"
    SATURATED = "saturated"
    OPTIMISTIC = "optimistic"
    PESSIMISTIC = "pessimistic"
    CONSISTENT = "consistent"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class Comparison:
    """A measured failure against Eq. 1 and the weakest link.

    Attributes:
        measured: Q or D.
        product: pi_marg.
        weakest: smallest of p0 and the threads' pr.
        p: two-sided, that the measured one differs from the product; None where that cannot be tested.
        p_equivalent: that it lies farther than .3 of the way to the weakest link from it, on either side.
        untested: whether too few worlds have the events, or there is no p.
    """

    measured: Figure
    product: Figure
    weakest: Figure
    p: float | None
    p_equivalent: float
    untested: bool

    @property
    def saturated(self) -> bool:
        """True if no formula can be told from another here."""
        return self.weakest.value < _LEAST_ROOM * self.product.value


def compare_units(outcomes: Outcomes, test: PermutationTest) -> Comparison:
    """Q against pi_marg, by a test of independence: the primary one, which holds at any shares."""
    if test.p is None:
        raise ValueError("a test of independence has a p")
    return _compare(outcomes, estimates.measured_in_units(outcomes), test.p)


def compare_forecast(outcomes: Outcomes) -> Comparison:
    """D against pi_marg, by the t-test of log D - log pi_marg, besides that of independence.

    Its variance has the floor of rare events, also where fewer than 5 worlds are expected to tell Eq. 1 from
    the weakest link. There is no test with fewer than 5 worlds with D and fewer expected by Eq. 1, where a
    finding would rest on so few.
    """
    measured, product = estimates.dual_failure(outcomes), estimates.product_of_margins(outcomes)
    shares, worlds = outcomes.margins, measured.worlds
    by_eq1 = prod(shares)
    few = few_events(measured.pseudo_values, shares) or worlds * (min(shares) - by_eq1) < FEW
    known = not few_events(measured.pseudo_values) or worlds * by_eq1 >= FEW
    t = t_of_log_ratio(measured, product, shares if few else None) if known else None
    return _compare(outcomes, measured, None if t is None else float(2 * stats.t.sf(abs(t), product.freedom)))


def _compare(outcomes: Outcomes, measured: Figure, p: float | None) -> Comparison:
    product, means = estimates.product_of_margins(outcomes), world_means(outcomes.columns)
    weakest = Figure.mean(means[int(np.argmin(means.mean(axis=1)))])
    untested = p is None or bool(((means > 0).sum(axis=1) < _LEAST_WORLDS).any())
    sides = [_p_of_side(measured, product.times(1 - k) + weakest.times(k), k) for k in (-_MARGIN, _MARGIN)]
    return Comparison(measured, product, weakest, p, max(sides), untested)


def _p_of_side(measured: Figure, bound: Figure, k: float) -> float:
    """One-sided p of E[measured] beyond the bound at k, on the scale on which the forecast is tested.

    The t-test of the difference itself says so with 5 to 9 % at the bound where few worlds have the event.
    """
    few = few_events(measured.pseudo_values) or measured.worlds * bound.value < FEW
    t = t_of_log_ratio(measured, bound, () if few else None)
    if t is None:
        return 0.0 if k < 0 else 1.0  # no share is below nothing
    return float(stats.t.sf(t if k < 0 else -t, measured.freedom))


def corrected(comparisons: Sequence[Comparison]) -> list[float | None]:
    """Holm's p-values; None where there is no test, which counts as one all the same."""
    adjusted = holm([1.0 if c.p is None else c.p for c in comparisons])
    return [None if c.p is None else float(p) for c, p in zip(comparisons, adjusted, strict=True)]


def verdicts(
    units: Sequence[Comparison], forecasts: Sequence[Comparison]
) -> tuple[list[Verdict], list[Verdict]]:
    """The verdicts on Q and on D of the confirmatory cells and lists of threads.

    Holm's correction is made over all of them, separately for independence, forecast and equivalence.
    """
    both = [*units, *forecasts]
    different = [*corrected(units), *corrected(forecasts)]
    alike = holm([c.p_equivalent for c in both])
    found = [_verdict(c, *p) for c, *p in zip(both, different, alike, strict=True)]
    return found[: len(units)], found[len(units) :]


def _verdict(comparison: Comparison, p: float | None, p_alike: float) -> Verdict:
    if p is None or comparison.untested:
        return Verdict.UNTESTED
    if comparison.saturated:
        return Verdict.SATURATED
    if p <= LEVEL:
        more = comparison.measured.value > comparison.product.value
        return Verdict.OPTIMISTIC if more else Verdict.PESSIMISTIC
    return Verdict.CONSISTENT if p_alike <= LEVEL else Verdict.UNDECIDED


def holm(p: Sequence[float]) -> Floats:
    """Holm's adjusted p-values.

    Source: Holm, "A simple sequentially rejective multiple test procedure", 1979.
    """
    adjusted, least = np.ones(len(p)), 0.0
    for rank, i in enumerate(np.argsort(p, kind="stable")):
        least = max(least, min(1.0, (len(p) - rank) * p[i]))
        adjusted[i] = least
    return adjusted
