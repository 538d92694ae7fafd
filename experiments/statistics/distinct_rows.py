"""Unbiased products of shares: every factor comes from a different row."""

from math import factorial

import numpy as np


def product_over_distinct_rows(columns: np.ndarray) -> float | None:
    """Mean of the product of one entry per column over all choices of distinct rows.

    The product of the columns' means is biased if the columns are correlated, since a row then multiplies
    with itself; this U-statistic is unbiased.

    Args:
        columns: (R, C) 0/1 or real entries; rows are exchangeable.

    Returns:
        The estimate of the product of the C expectations; None with fewer rows than columns.

    Source: Hoeffding, "A class of statistics with asymptotically normal distribution", 1948; the sum over set
    partitions is Moebius inversion on their lattice.
    """
    x = np.asarray(columns, float)
    rows, count = x.shape
    if rows < count:
        return None
    total = 0.0
    for partition in _set_partitions(count):
        term = 1.0
        for block in partition:
            sign = -1 if len(block) % 2 == 0 else 1
            term *= sign * factorial(len(block) - 1) * float(x[:, block].prod(axis=1).sum())
        total += term
    choices = float(np.prod([rows - k for k in range(count)]))
    return total / choices


def _set_partitions(count: int) -> list[list[list[int]]]:
    """All partitions of 0 .. count - 1 into blocks."""
    partitions: list[list[list[int]]] = [[]]
    for element in range(count):
        grown = []
        for partition in partitions:
            grown.append([*partition, [element]])
            for place, block in enumerate(partition):
                grown.append([*partition[:place], [*block, element], *partition[place + 1 :]])
        partitions = grown
    return partitions
