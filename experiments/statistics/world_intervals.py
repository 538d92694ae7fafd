"""Intervals with worlds as the sample."""

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from scipy import stats

from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.outcomes import Floats
from dslab.experiments.statistics.products import ROUNDING

FEW = 5
"""Worlds with an event, or expected to have it, below which their spread is not known."""


@dataclass(frozen=True)
class Interval:
    """An estimate with an interval of 95 %.

    Attributes:
        value: the estimate.
        low, high: ends; -inf and inf where it is unbounded.
    """

    value: float
    low: float
    high: float

    def __post_init__(self) -> None:
        if not self.low <= self.value <= self.high:
            raise ValueError(f"{self.value} is not in [{self.low}, {self.high}]")


def share_interval(share: Figure | Floats) -> Interval:
    """Wilson's interval of a share, with as many trials as its spread over the worlds is worth.

    Args:
        share: itself, or the (W,) mean of each world, of at least two; with one the interval is [0, 1].
    """
    share = share if isinstance(share, Figure) else Figure.mean(share)
    worlds, p = share.worlds, share.value
    if worlds < 2:
        return Interval(p, 0.0, 1.0)
    trials = p * (1 - p) / share.error**2 if share.error else float(worlds)
    return wilson_interval(p, trials, worlds)


def wilson_interval(p: float, trials: float, worlds: float) -> Interval:
    """Wilson's interval of a share of so many trials, with Student's t of the worlds, 2 or more, or inf."""
    z2 = student(worlds - 1) ** 2
    middle = (p + z2 / (2 * trials)) / (1 + z2 / trials)
    half = sqrt(z2 * (p * (1 - p) / trials + z2 / (4 * trials**2))) / (1 + z2 / trials)
    return Interval(p, max(0.0, min(middle - half, p)), min(1.0, max(middle + half, p)))


def difference_interval(figure: Figure) -> Interval:
    """Interval of a difference or sum of figures over the same worlds, by its pseudo-values."""
    half = student(figure.freedom) * figure.error
    return Interval(figure.value, figure.value - half, figure.value + half)


def ratio_interval(
    numerator: Figure, denominator: Figure, rare: tuple[float, ...] | None = None
) -> Interval | None:
    """Ratios that the pseudo-values of both figures do not contradict.

    Args:
        numerator, denominator: over the same worlds.
        rare: given where too few worlds have the numerator's event for their spread to be known: the variance
            is then at least that of counts. It is p0 and pr of the threads, where the denominator is their
            product; empty otherwise.

    Returns:
        The interval around the ratio; None if the denominator is 0.

    Source: Fieller 1940, by pseudo-values.
    """
    if denominator.value <= 0:
        return None
    a, c = numerator.value, denominator.value
    cov = np.cov(numerator.pseudo_values, denominator.pseudo_values)
    factor = student(numerator.freedom) ** 2 / numerator.worlds
    # (a - rho c)^2 <= factor * variance(rho), as coefficients of rho^2, rho and 1.
    spread = (c**2 - factor * cov[1, 1], -2 * (a * c - factor * cov[0, 1]), a**2 - factor * cov[0, 0])
    bounds = [_around(a / c, *spread)]
    if rare is not None:
        product = float(np.prod(rare)) if rare else c
        squared = product**2 * (1 + sum(1 / p - 1 for p in rare))
        bounds.append(_around(a / c, c**2 + factor * squared, -2 * a * c - factor * product, a**2))
    return Interval(a / c, min(low for low, _ in bounds), max(high for _, high in bounds))


def t_of_log_ratio(
    numerator: Figure, denominator: Figure, rare: tuple[float, ...] | None = None
) -> float | None:
    """Student's t of log A - log C, by the pseudo-values of both: 0 where the ratio A / C is 1.

    A numerator below half a world counts as that, since 0 has no logarithm. With ``rare`` the variance per
    world is at least that of counts, v0(rho) = A - A^2 (1 + sum(1 / p - 1)) with A = rho C, brought onto the
    log scale by the delta method, d log(A / C) = (dA - rho dC) / A: v0 / A^2 = 1 / A - (1 + sum(1 / p - 1)),
    and 1 / A - 1 where C is no product of shares. It falls from the ratio that is tested, 1, to a larger one
    that is found; there it is taken half way on the log scale, at A = sqrt(A C). With A = C instead 16 worlds
    with .4 expected would have a p of .02, with the A found 5 with 1.3 expected one of .003 instead of .01.

    The arguments are those of :func:`ratio_interval`. None if the denominator is not above 0, also without
    one of the worlds.
    """
    if min(denominator.value, float(denominator.without.min())) <= 0:
        return None
    least = 0.5 / numerator.worlds
    ratio = numerator.log(least) - denominator.log()
    error = ratio.error
    if rare is not None:
        a = max(numerator.value, least)
        spread = 1 / min(a, sqrt(a * denominator.value)) - 1 - sum(1 / p - 1 for p in rare)
        error = max(error, sqrt(max(spread, 0.0) / ratio.worlds))
    return ratio.value / error if error else ratio.t


def median_interval(by_world: Floats) -> Interval:
    """Median over worlds with the interval between two of their order statistics, of at least 95 %.

    The number of (W,) values below the true median is binomial with share 1/2, whatever their distribution:
    [x_(k), x_(W + 1 - k)] misses it with probability 2 P(B < k), and k is the largest for which that is at
    most 5 %. Below six worlds there is none, and the interval is unbounded.

    Source: Conover, Practical Nonparametric Statistics, 1999, Sec. 3.2.
    """
    ordered = np.sort(np.asarray(by_world, float))
    middle = float(np.median(ordered))
    k = int(stats.binom.ppf(0.025, len(ordered), 0.5))
    if 2 * stats.binom.cdf(k, len(ordered), 0.5) <= 0.05:
        k += 1
    return Interval(middle, float(ordered[k - 1]), float(ordered[-k])) if k else Interval(middle, -inf, inf)


def few_events(by_world: Floats, shares: tuple[float, ...] = ()) -> bool:
    """Return True if too few worlds have an event for the spread of (W,) means to be known."""
    worlds, nothing = len(by_world), ROUNDING * float(np.abs(by_world).max(initial=0.0))
    expected = [float(np.prod(shares)), float(np.prod([1 - p for p in shares]))] if shares else []
    return int((by_world > nothing).sum()) < FEW or any(worlds * p < FEW for p in expected)


def student(freedom: float) -> float:
    """Student's t of an interval of 95 %."""
    return float(stats.t.ppf(0.975, freedom))


def _around(rho: float, square: float, linear: float, constant: float) -> tuple[float, float]:
    """Ends of the piece around ``rho`` where a quadratic is not positive; ``rho`` itself if there is none."""
    if square * rho**2 + linear * rho + constant > 1e-12 * (abs(constant) + abs(square) * rho**2):
        return rho, rho
    if abs(square) < 1e-300:
        if linear == 0:
            return -inf, inf
        end = -constant / linear
        return (-inf, max(end, rho)) if linear > 0 else (min(end, rho), inf)
    root = linear**2 - 4 * square * constant
    if root <= ROUNDING * linear**2:  # the rounding of two large terms: its square root is no width
        return (rho, rho) if square > 0 else (-inf, inf)
    ends = sorted((-linear + sign * sqrt(root)) / (2 * square) for sign in (-1, 1))
    if square > 0:
        return min(ends[0], rho), max(ends[1], rho)
    return (-inf, max(ends[0], rho)) if rho <= ends[0] else (min(ends[1], rho), inf)


def way_interval(measured: Figure, product: Figure, weakest: Figure) -> Interval | None:
    """Way k = (measured - product) / (weakest - product) with its interval by worlds.

    0 is Eq. 1, 1 the weakest link. The spread of the failure is not known where fewer than 5 worlds have it,
    or by Eq. 1 are to have it or not to have it: the interval is then at least that of so many trials as
    there are worlds.

    Args:
        measured: Q or D.
        product: pi_marg, over the same worlds.
        weakest: the smallest of p0 and the threads' pr.

    Returns:
        The way; None with fewer than 3 worlds, or where Eq. 1 and the weakest link are the same.
    """
    room = weakest - product
    if measured.worlds < 3 or room.value <= 0 or not np.isfinite([*measured.without, *product.without]).all():
        return None
    found = ratio_interval(measured - product, room)
    if found is None or not few_events(measured.pseudo_values, (product.value,)):
        return found
    trials = wilson_interval(min(max(measured.value, 0.0), 1.0), measured.worlds, measured.worlds)
    ends = [(end - product.value) / room.value for end in (trials.low, trials.high)]
    return Interval(found.value, min(found.low, ends[0]), max(found.high, ends[1]))
