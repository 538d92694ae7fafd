"""Planning: the number of units that a cell needs, by the test that will judge it."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from experiments.statistics.joint import Floats, draw_tables, independent, margins_of
from experiments.statistics.likelihood_ratio import signed_root

_MOST_UNITS = 10_000_000


@dataclass(frozen=True)
class Plan:
    """Number of units for a cell.

    Attributes:
        units: least number found, None if over ten million.
        power: reached with that many.
        predicted: p0 · Π pr_j.
        measured: with the wanted ratio.
    """

    units: int | None
    power: float
    predicted: float
    measured: float


def power_of(
    p0: float,
    pr: tuple[float, ...],
    ratio: float,
    units: int,
    alpha: float = 0.05,
    replicates: int = 4000,
    seed: int = 0,
) -> float:
    """Probability that the likelihood-ratio test rejects Eq. 1 at this true ratio.

    Args:
        p0: guessed P(B).
        pr: guessed pr_j, one per recovery thread.
        ratio: true measured / predicted, > 0.
        units: completed units of the cell.
        alpha: size of the test; divide by the number of cells to plan for Holm's correction.
        replicates: drawn under H0 and under the alternative, with outcomes of a unit otherwise independent.
        seed: of the draws.

    Raises:
        ValueError: a probability outside (0, 1), or a ratio that makes P(D_n | B) larger than 1.
    """
    share = _checked(p0, pr, ratio)
    rng = np.random.default_rng(seed)
    null, alternative = (
        np.abs(signed_root(margins_of(draw_tables(rng, _model(p0, s, pr), units, replicates))))
        for s in (math.prod(pr), share)
    )
    # As in the test: p = (1 + larger of the null) / (1 + replicates) <= alpha.
    allowed = math.floor(alpha * (1 + replicates) + 1e-9) - 1
    if allowed < 0:
        return 0.0
    critical = np.sort(null)[replicates - 1 - allowed] if allowed < replicates else -1.0
    return float(np.mean(alternative > critical + 1e-9))


def units_needed(
    p0: float,
    pr: tuple[float, ...],
    ratio: float,
    power: float = 0.8,
    alpha: float = 0.05,
    replicates: int = 4000,
    seed: int = 0,
) -> Plan:
    """Least number of units with which the test detects a ratio with the wanted power.

    The search starts at the delta method's estimate and ends within 2% of the answer.

    Raises:
        ValueError: as `power_of`; a ratio of 1; a power outside (0, 1).
    """
    share = _checked(p0, pr, ratio)
    if ratio == 1 or not 0 < power < 1:
        raise ValueError(f"ratio {ratio} or power {power} can be had with no number of units")

    def reached(units: int) -> float:
        return power_of(p0, pr, ratio, units, alpha, replicates, seed)

    predicted = p0 * math.prod(pr)
    high = max(2, _by_delta_method(p0, share, pr, ratio, power, alpha))
    while reached(high) < power:
        high *= 2
        if high > _MOST_UNITS:
            return Plan(None, reached(_MOST_UNITS), predicted, p0 * share)
    low = high // 2
    while low > 1 and reached(low) >= power:
        high, low = low, low // 2
    while high - low > max(1, high // 50):
        middle = (low + high) // 2
        low, high = (low, middle) if reached(middle) >= power else (middle, high)
    return Plan(high, reached(high), predicted, p0 * share)


def units_to_measure(p: float, relative_half_width: float, confidence: float = 0.95) -> int:
    """Number of units that measures a probability to this relative half-width (normal approximation).

    Raises:
        ValueError: p outside (0, 1) or a half-width that is not positive.
    """
    if not 0 < p < 1 or relative_half_width <= 0:
        raise ValueError(f"p {p} or half-width {relative_half_width} out of range")
    z = float(norm.ppf((1 + confidence) / 2))
    return math.ceil(z * z * (1 - p) / (p * relative_half_width**2))


def _checked(p0: float, pr: tuple[float, ...], ratio: float) -> float:
    """P(D_n | B) at this ratio."""
    if not pr or not all(0 < p < 1 for p in (p0, *pr)):
        raise ValueError(f"p0 {p0} and pr {pr} must lie strictly between 0 and 1")
    share = ratio * math.prod(pr)
    if not 0 < share <= 1:
        raise ValueError(f"at pr {pr} no ratio of {ratio} is possible: at most {1 / math.prod(pr):.3g}")
    return share


def _model(p0: float, share: float, pr: tuple[float, ...]) -> Floats:
    return independent(np.array([1 - p0, p0 * (1 - share), p0 * share]), np.array(pr))


def _by_delta_method(
    p0: float, share: float, pr: tuple[float, ...], ratio: float, power: float, alpha: float
) -> int:
    variance = (1 - share) / (p0 * share) + sum((1 - p) / p for p in pr)
    z = float(norm.ppf(1 - alpha / 2) + norm.ppf(power))
    return math.ceil(variance * (z / math.log(ratio)) ** 2)
