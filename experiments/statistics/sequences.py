"""A confidence sequence: an interval of a proportion that stays valid under repeated looks."""

import math

from scipy.optimize import brentq
from scipy.special import betaln, xlog1py, xlogy

from experiments.statistics.intervals import Proportion


def confidence_sequence(events: int, units: int, confidence: float = 0.95, prior: float = 0.5) -> Proportion:
    """Beta-binomial confidence sequence at this count.

    The probability that the true share is ever outside, at any number of units, is at most 1 - confidence,
    so that a run may stop as soon as its interval is narrow enough. It is wider than an interval for a number
    of units fixed beforehand: it contains every p that the mixture Beta(prior, prior) has not refuted by a
    factor of 1 / (1 - confidence).

    Args:
        events: count, 0 <= events <= units.
        units: number so far; 0 gives [0, 1].
        confidence: in (0, 1).
        prior: both parameters of the mixture, > 0, fixed before the run.

    Raises:
        ValueError: arguments outside these ranges.

    Source: Robbins, "Statistical methods related to the law of the iterated logarithm", Annals of
        Mathematical Statistics 1970; Ville's inequality.
    """
    if not 0 <= events <= units:
        raise ValueError(f"{events} events of {units} units")
    if not 0 < confidence < 1 or prior <= 0:
        raise ValueError(f"confidence {confidence} or prior {prior} out of range")
    if units == 0:
        return Proportion(0, 0, 0.0, 1.0, confidence)
    log_mixture = betaln(prior + events, prior + units - events) - betaln(prior, prior)
    bound = log_mixture + math.log(1 - confidence)

    def excess(p: float) -> float:
        return float(xlogy(events, p) + xlog1py(units - events, -p) - bound)

    best = events / units
    low = brentq(excess, 1e-300, best, xtol=1e-12) if events > 0 else 0.0
    high = brentq(excess, best, 1 - 1e-16, xtol=1e-12) if events < units else 1.0
    return Proportion(events, units, float(low), float(high), confidence)
