"""Exact intervals of proportions of independent trials, for the paper's own tables."""

from dataclasses import dataclass

from scipy.stats import beta


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
    if not 0 <= events <= units:
        raise ValueError(f"{events} events of {units} units")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence {confidence} is not in (0, 1)")
    tail = (1 - confidence) / 2
    low = float(beta.ppf(tail, events, units - events + 1)) if events > 0 else 0.0
    high = float(beta.isf(tail, events + 1, units - events)) if events < units else 1.0
    return Proportion(events, units, low, high, confidence)
