"""Intervals of proportions."""

from dataclasses import dataclass
from typing import Literal

from statsmodels.stats.proportion import proportion_confint


@dataclass(frozen=True)
class Proportion:
    """A share of units and its interval, never NaN.

    Attributes:
        events: number of units with the property.
        units: number of units.
        low, high: ends of the interval.
        confidence: of the interval.
    """

    events: int
    units: int
    low: float
    high: float
    confidence: float = 0.95

    @property
    def estimate(self) -> float | None:
        """The share; None without units."""
        return self.events / self.units if self.units else None


def clopper_pearson(events: int, units: int, confidence: float = 0.95) -> Proportion:
    """Exact interval, which covers any true share with at least the stated confidence.

    Args:
        events: count, 0 <= events <= units.
        units: number of independent units; 0 gives the interval [0, 1].
        confidence: in (0, 1).

    Raises:
        ValueError: arguments outside these ranges.

    Source: Clopper & Pearson, "The use of confidence or fiducial limits", Biometrika 1934.
    """
    return _interval(events, units, confidence, "beta")


def jeffreys(events: int, units: int, confidence: float = 0.95) -> Proportion:
    """Equal-tailed interval of the posterior under Jeffreys' prior Beta(1/2, 1/2).

    It has the stated coverage on average over true shares, and is shorter than the exact one. No units give
    [0, 1]. It reaches 0 without events, and 1 if every unit is an event.

    Raises:
        ValueError: as `clopper_pearson`.

    Source: Brown, Cai & DasGupta, "Interval estimation for a binomial proportion", Statistical Science 2001.
    """
    return _interval(events, units, confidence, "jeffreys")


def _interval(events: int, units: int, confidence: float, method: Literal["beta", "jeffreys"]) -> Proportion:
    if not 0 <= events <= units:
        raise ValueError(f"{events} events of {units} units")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence {confidence} is not in (0, 1)")
    low, high = 0.0, 1.0
    if units:  # statsmodels returns NaN for none
        low, high = map(float, proportion_confint(events, units, 1 - confidence, method))
    # Brown, Cai & DasGupta's interval includes the shares 0 and 1 if they were observed; that of statsmodels
    # does not.
    return Proportion(events, units, low if events > 0 else 0.0, high if events < units else 1.0, confidence)
