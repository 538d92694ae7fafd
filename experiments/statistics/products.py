"""Unbiased products of shares: every factor comes from a different row."""

from functools import cache
from math import factorial

import numpy as np

from dslab.experiments.statistics.outcomes import Floats

ROUNDING = 1e-12
"""What is less than this, of the figures that it is a sum or difference of, is nothing."""


def product_of_distinct(x: Floats) -> Floats:
    """The U-statistic u(X): mean of the product of one entry per column over all choices of distinct rows.

    The product of the columns' means is biased if the columns are correlated, since a row then multiplies
    with itself; this U-statistic is unbiased.

    Args:
        x: (C, ..., R) entries of C columns; a row with NaN in any column is left out.

    Returns:
        (...) estimates of the product of the C expectations; NaN with fewer rows than columns.

    Source: Hoeffding, "A class of statistics with asymptotically normal distribution", 1948; the sum over set
    partitions is Moebius inversion on their lattice.
    """
    valid = np.isfinite(x).all(axis=0)
    x = np.where(valid, x, 0.0)
    sums = {block: _product(x, block).sum(axis=-1) for block in _blocks(len(x))}
    return _over_choices(sums, valid.sum(axis=-1), len(x))


def product_without_each(x: Floats) -> Floats:
    """U of the other rows, for each row: (R,) from (C, R) entries without NaN."""
    sums = {}
    for block in _blocks(len(x)):
        rows = _product(x, block)
        sums[block] = rows.sum() - rows
    return _over_choices(sums, np.full(x.shape[1], x.shape[1] - 1), len(x))


def _over_choices(sums: dict[tuple[int, ...], Floats], rows: np.ndarray, columns: int) -> Floats:
    total, size = np.zeros(np.shape(rows)), np.zeros(np.shape(rows))
    for partition in _set_partitions(columns):
        term = np.ones(np.shape(rows))
        for block in partition:
            term = term * ((-1) ** (len(block) - 1) * factorial(len(block) - 1)) * sums[block]
        total, size = total + term, size + np.abs(term)
    total = np.where(np.abs(total) > ROUNDING * size, total, 0.0)
    choices = np.ones(np.shape(rows))
    for k in range(columns):
        choices = choices * (rows - k)
    enough = rows >= columns
    return np.where(enough, total / np.where(enough, choices, 1.0), np.nan)


def _product(x: Floats, block: tuple[int, ...]) -> Floats:
    return np.prod(x[list(block)], axis=0)


def _blocks(columns: int) -> set[tuple[int, ...]]:
    return {block for partition in _set_partitions(columns) for block in partition}


@cache
def _set_partitions(count: int) -> tuple[tuple[tuple[int, ...], ...], ...]:
    """All partitions of 0 .. count - 1 into blocks."""
    partitions: list[tuple[tuple[int, ...], ...]] = [()]
    for element in range(count):
        grown = []
        for partition in partitions:
            grown.append((*partition, (element,)))
            for place, block in enumerate(partition):
                grown.append((*partition[:place], (*block, element), *partition[place + 1 :]))
        partitions = grown
    return tuple(partitions)
