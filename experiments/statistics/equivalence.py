"""Equivalence (two one-sided tests) of measured and predicted, and Holm's correction."""

from collections.abc import Sequence

import numpy as np
from statsmodels.stats.multitest import multipletests

from experiments.statistics.joint import JointCounts
from experiments.statistics.likelihood_ratio import one_sided_p


def tost(counts: JointCounts, bound: float, replicates: int, rng: np.random.Generator) -> float | None:
    """The p of H0 "the log ratio of measured to predicted is at least log(bound) away from 0".

    Not rejecting Eq. 1 does not confirm it; rejecting this H0 does: the ratio is then in (1/bound, bound).

    Args:
        counts: of a cell.
        bound: > 1.
        replicates: drawn at each edge.
        rng: of the draws.

    Returns:
        The larger p of the two one-sided tests; None if the counts are not informative.

    Raises:
        ValueError: bound <= 1.

    Source: Schuirmann, "A comparison of the two one-sided tests procedure", 1987.
    """
    if bound <= 1:
        raise ValueError(f"equivalence bound {bound} is not above 1")
    found = counts.margins
    if found.breakages[0] == 0 or (found.failures[0] == 0 and found.crossings[0].min() == 0):
        return None
    not_larger = one_sided_p(counts, bound, above=False, replicates=replicates, rng=rng)
    not_smaller = one_sided_p(counts, 1 / bound, above=True, replicates=replicates, rng=rng)
    return max(not_larger, not_smaller)


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Holm's corrected p in the given order; None stays None and does not count as a test.

    Source: Holm, "A simple sequentially rejective multiple test procedure", Scand. J. of Statistics 1979.
    """
    tested = [i for i, p in enumerate(p_values) if p is not None]
    corrected: list[float | None] = [None] * len(p_values)
    if tested:
        for i, p in zip(tested, multipletests([p_values[i] for i in tested], method="holm")[1], strict=True):
            corrected[i] = float(p)
    return corrected
