"""Eq. 1 in one cell: P(D_n) predicted from p0 and the crossing arm's pr_j, and P(D_n) measured.

Source: Huang et al., "Dual-SLAM", IROS 2020, Eq. (1).
"""

import math
from dataclasses import dataclass

import numpy as np

from experiments.statistics.joint import (
    DUAL_FAILURE,
    NO_BREAKAGE,
    RECOVERED,
    Floats,
    JointCounts,
    patterns,
)
from experiments.statistics.results import Estimate, Verdict

_PREDICTED = "p0 · Π pr_j of the crossing arm; limits of joint posterior draws"
_RATIO = "measured over predicted; limits of joint posterior draws"


@dataclass(frozen=True)
class Draws:
    """Joint draws of the probabilities in Eq. 1, paired as the units are.

    Attributes:
        p0: (D,) probability of a breakage.
        share: (D,) P(D_n | B).
        pr: (D, n) probabilities of R_j.
    """

    p0: Floats
    share: Floats
    pr: Floats


def posterior_draws(
    counts: JointCounts, state: int, failed: bool, draws: int, rng: np.random.Generator
) -> Draws:
    """Draw from the posterior whose prior is one further unit.

    The quantiles with the unit that speaks most against a large value, and with the one that speaks most for
    it, are the limits of an interval. For a single share they are those of Clopper and Pearson; as no prior
    pulls between them, they enclose the estimate that has none.

    Args:
        counts: of the units.
        state: the further unit's state in the free arm.
        failed: True if all its threads failed in the crossing arm, False if none did.
        draws: number D.
        rng: of the draws.

    Source: Walley, "Inferences from multinomial data", J. Royal Statistical Society B 1996.
    """
    table = counts.table.astype(float)
    table[state, -1 if failed else 0] += 1
    shares = rng.standard_gamma(table, (draws, *table.shape))
    shares /= shares.sum(axis=(1, 2), keepdims=True)
    rows = shares.sum(axis=2)
    p0 = rows[:, RECOVERED] + rows[:, DUAL_FAILURE]
    share = np.divide(rows[:, DUAL_FAILURE], p0, out=np.zeros_like(p0), where=p0 > 0)
    return Draws(p0, share, shares.sum(axis=1) @ patterns(counts.threads).astype(float))


def predicted_and_ratio(
    counts: JointCounts, draws: int, rng: np.random.Generator, confidence: float = 0.95
) -> tuple[Estimate, Estimate]:
    """P(D_n) by Eq. 1, and measured over predicted, with limits of `posterior_draws`.

    p0 cancels in the ratio, which is P(D_n | B) / Π pr_j: it is undetermined without a breakage, and has no
    upper bound if some thread never failed to cross.
    """
    found = counts.margins
    units, breakages, failures = (float(x[0]) for x in (found.units, found.breakages, found.failures))
    if units == 0:
        return Estimate.undetermined(_PREDICTED), Estimate.undetermined(_RATIO)
    product = float(np.prod(found.crossings[0] / units))
    least, most = (1 - confidence) / 2, (1 + confidence) / 2
    below = posterior_draws(counts, NO_BREAKAGE, False, draws, rng)
    above = posterior_draws(counts, DUAL_FAILURE, True, draws, rng)
    predicted = Estimate(
        breakages / units * product,
        float(np.quantile(below.p0 * below.pr.prod(axis=1), least)),
        float(np.quantile(above.p0 * above.pr.prod(axis=1), most)),
        _PREDICTED,
    )
    if breakages == 0 or (failures == 0 and product == 0):
        return predicted, Estimate.undetermined(_RATIO)
    below = posterior_draws(counts, RECOVERED, True, draws, rng)
    low = float(np.quantile(below.share / below.pr.prod(axis=1), least))
    if product == 0:
        return predicted, Estimate(None, low, None, _RATIO)
    above = posterior_draws(counts, DUAL_FAILURE, False, draws, rng)
    high = float(np.quantile(above.share / above.pr.prod(axis=1), most))
    return predicted, Estimate(failures / breakages / product, low, high, _RATIO)


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
