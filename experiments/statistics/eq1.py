"""Eq. 1 in one cell: P(D_n) predicted from p0 and the crossing arm's pr_j, and P(D_n) measured.

Source: Huang et al., "Dual-SLAM", IROS 2020, Eq. (1).
"""

import math

import numpy as np

from experiments.statistics.joint import Floats, JointCounts, patterns
from experiments.statistics.results import Estimate, Verdict

_PREDICTED = "p0 · Π pr_j of the crossing arm; interval of joint posterior draws"
_RATIO = "measured over predicted; interval of joint posterior draws"


def posterior_draws(
    counts: JointCounts, draws: int, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Joint draws of p0, of P(D_n | B) and of the pr_j, paired as the units are.

    The prior is Jeffreys' for p0 and for P(D_n | B), and one unit's worth spread evenly over the patterns of
    the crossing arm, which leaves each pr_j close to Jeffreys' own posterior.

    Returns:
        (draws,) p0, (draws,) P(D_n | B), (draws, n) pr_j.
    """
    table = counts.table
    rows = table.sum(axis=1)
    p0 = rng.beta(rows[1] + rows[2] + 0.5, rows[0] + 0.5, draws)
    share = rng.beta(rows[2] + 0.5, rows[1] + 0.5, draws)
    states = np.stack([1 - p0, p0 * (1 - share), p0 * share])
    failed = patterns(counts.threads).astype(float)
    pr = np.zeros((draws, counts.threads))
    for state in range(3):
        shares = rng.standard_gamma(table[state] + 1 / table.size, (draws, table.shape[1])) + 1e-300
        pr += states[state][:, None] * (shares / shares.sum(axis=1, keepdims=True)) @ failed
    return p0, share, pr


def predicted_and_ratio(
    counts: JointCounts, draws: int, rng: np.random.Generator, confidence: float = 0.95
) -> tuple[Estimate, Estimate]:
    """P(D_n) by Eq. 1, and measured over predicted, with equal-tailed posterior intervals.

    p0 cancels in the ratio, which is P(D_n | B) / Π pr_j: it is undetermined without a breakage, and has no
    upper bound if some thread never failed to cross.
    """
    found = counts.margins
    units, breakages, failures = (float(x[0]) for x in (found.units, found.breakages, found.failures))
    crossings = found.crossings[0]
    if units == 0:
        return Estimate.undetermined(_PREDICTED), Estimate.undetermined(_RATIO)
    p0, share, pr = posterior_draws(counts, draws, rng)
    product = float(np.prod(crossings / units))
    tails = [(1 - confidence) / 2, (1 + confidence) / 2]
    low, high = np.quantile(p0 * pr.prod(axis=1), tails)
    value = breakages / units * product
    predicted = Estimate(
        value, float(low) if value > 0 else 0.0, float(high) if value < 1 else 1.0, _PREDICTED
    )
    if breakages == 0 or (failures == 0 and product == 0):
        return predicted, Estimate.undetermined(_RATIO)
    low, high = np.quantile(share / pr.prod(axis=1), tails)
    ratio = Estimate(
        failures / breakages / product if product > 0 else None,
        float(low) if failures > 0 else 0.0,
        float(high) if product > 0 else None,
        _RATIO,
    )
    return predicted, ratio


def predicted_at_free_length(
    p0: float | None, pr: list[float | None], frames_free: float | None, frames_cross: float | None
) -> float | None:
    """Eq. 1 with each pr_j scaled to the free arm's length at a constant hazard per frame.

    Args:
        p0: of the cell.
        pr: of the crossing arm.
        frames_free, frames_cross: median frames that a recovery thread had to cross in either arm.

    Returns:
        The probability; None if an argument is missing.
    """
    if p0 is None or not frames_cross or frames_free is None or any(p is None for p in pr):
        return None
    return p0 * math.prod(1 - (1 - p) ** (frames_free / frames_cross) for p in pr if p is not None)


def verdict(
    corrected_p: float | None, measured_above: bool, power: float | None, alpha: float, power_wanted: float
) -> Verdict:
    """Verdict of a cell on Eq. 1.

    A rejection is valid at any power. If Eq. 1 is not rejected, the cell is consistent with it only if a
    ratio of 2 would have been rejected with the wanted probability; otherwise the cell is undecided.

    Args:
        corrected_p: of the likelihood-ratio test, by Holm; None if nothing could be tested.
        measured_above: measured P(D_n) is above the predicted one.
        power: achieved power for the ratio of 2.
        alpha: size of the test.
        power_wanted: least power for the verdict "consistent".
    """
    if corrected_p is not None and corrected_p <= alpha:
        return "optimistic" if measured_above else "pessimistic"
    if corrected_p is not None and power is not None and power >= power_wanted:
        return "consistent"
    return "undecided"
