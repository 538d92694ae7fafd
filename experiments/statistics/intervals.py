"""Intervals of proportions. Pure: counts in, numbers out."""

from dataclasses import dataclass

from scipy.stats import beta


@dataclass(frozen=True)
class Proportion:
    """A share of units and its interval; all NaN-free.

    Attributes:
        events: how many had the property.
        units: out of how many.
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
        """The share; None of no units."""
        return self.events / self.units if self.units else None


def clopper_pearson(events: int, units: int, confidence: float = 0.95) -> Proportion:
    """Exact interval: it covers the true share with at least the stated confidence, whatever that share is.

    Args:
        events: count, 0 <= events <= units.
        units: number of independent units; 0 gives the interval [0, 1].
        confidence: in (0, 1).

    Raises:
        ValueError: arguments outside these ranges.

    Source: Clopper & Pearson, "The use of confidence or fiducial limits", Biometrika 1934.
    """
    if not 0 <= events <= units:
        raise ValueError(f"{events} events of {units} units")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence {confidence} is not in (0, 1)")
    tail = (1 - confidence) / 2
    low = float(beta.ppf(tail, events, units - events + 1)) if events > 0 else 0.0
    high = float(beta.ppf(1 - tail, events + 1, units - events)) if events < units else 1.0
    return Proportion(events, units, low, high, confidence)
