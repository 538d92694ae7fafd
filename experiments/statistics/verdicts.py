"""What is concluded on Eq. 1: tests of one cell and list of threads, and the first verdict that applies."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy import stats

from experiments.statistics import estimates
from experiments.statistics.estimates import Figure
from experiments.statistics.outcomes import Floats, Outcomes, world_means
from experiments.statistics.permutations import PermutationTest

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
        p: two-sided, that the measured one differs from the product.
        p_equivalent: that it lies farther than .3 of the way to the weakest link from it, on either side.
        untested: whether too few worlds have the events.
    """

    measured: Figure
    product: Figure
    weakest: Figure
    p: float
    p_equivalent: float
    untested: bool

    @property
    def saturated(self) -> bool:
        """True if no formula can be told from another here."""
        return self.product.value <= 0 or self.weakest.value / self.product.value < _LEAST_ROOM


def compare_units(outcomes: Outcomes, test: PermutationTest) -> Comparison:
    """Q against pi_marg, by a test of independence."""
    if test.p is None:
        raise ValueError("a test of independence has a p")
    return _compare(outcomes, estimates.measured_in_units(outcomes), test.p)


def compare_forecast(outcomes: Outcomes) -> Comparison:
    """D against pi_marg, by the t-test of their pseudo-values."""
    measured, product = estimates.dual_failure(outcomes), estimates.product_of_margins(outcomes)
    p = float(2 * stats.t.sf(abs((measured - product).t), product.freedom))
    return _compare(outcomes, measured, p)


def _compare(outcomes: Outcomes, measured: Figure, p: float) -> Comparison:
    product, means = estimates.product_of_margins(outcomes), world_means(outcomes.columns)
    weakest = Figure.mean(means[int(np.argmin(means.mean(axis=1)))])
    sides = []
    for k in (-_MARGIN, _MARGIN):
        beyond = measured - product.times(1 - k) - weakest.times(k)
        sides.append(float(stats.t.sf(beyond.t if k < 0 else -beyond.t, product.freedom)))
    untested = bool(((means > 0).sum(axis=1) < _LEAST_WORLDS).any())
    return Comparison(measured, product, weakest, p, max(sides), untested)


def verdicts(
    units: Sequence[Comparison], forecasts: Sequence[Comparison]
) -> tuple[list[Verdict], list[Verdict]]:
    """The verdicts on Q and on D of the confirmatory cells and lists of threads.

    Holm's correction is made over all of them, separately for independence, forecast and equivalence.
    """
    both = [*units, *forecasts]
    different = [*holm([c.p for c in units]), *holm([c.p for c in forecasts])]
    alike = holm([c.p_equivalent for c in both])
    found = [_verdict(c, *p) for c, *p in zip(both, different, alike, strict=True)]
    return found[: len(units)], found[len(units) :]


def _verdict(comparison: Comparison, p: float, p_alike: float) -> Verdict:
    if comparison.untested:
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
