"""Tests of independence that permute outcomes: whole worlds, or replicates within their sequences."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.statistics.outcomes import Floats, Outcomes, world_means

_LEAST_TELLING = 20  # sequences
_AT_ONCE = 1_000_000  # outcomes of the permutations that are in memory together


@dataclass(frozen=True)
class PermutationTest:
    """Result of a permutation test.

    Attributes:
        statistic: the observed one.
        expected: its mean over the permutations.
        p: two-sided; None where no test was made.
        telling: sequences in which both B and a thread's failure vary; None where they do not matter.
    """

    statistic: float
    expected: float | None
    p: float | None
    telling: int | None = None

    @property
    def sign(self) -> int:
        """1 if more than expected, -1 if less, 0 if neither or unknown."""
        return 0 if self.expected is None else int(np.sign(self.statistic - self.expected))


def permutations_for(tests: int) -> int:
    """Number of permutations that lets the smallest p of so many tests pass Holm's first step."""
    return max(9999, 400 * tests)


def independence(outcomes: Outcomes, rng: np.random.Generator, permutations: int = 9999) -> PermutationTest:
    """Q against Q with every thread's outcomes moved to other worlds, whole worlds at a time.

    The replicates of a world stay together, so that the test holds at any correlation within worlds.
    """
    columns = outcomes.of_worlds(outcomes.has_units).columns
    worlds = np.arange(columns.shape[1])
    observed = float(_moved(columns, [worlds[None]] * outcomes.threads)[0])
    everyone = np.tile(worlds, (permutations, 1))
    others = [rng.permuted(everyone, axis=1) for _ in range(outcomes.threads)]
    at_once = max(1, _AT_ONCE // columns[0].size)
    parts = range(0, permutations, at_once)
    moved = np.concatenate([_moved(columns, [each[i : i + at_once] for each in others]) for i in parts])
    return PermutationTest(observed, float(moved.mean()), _two_sided(observed, moved))


def within_sequences(
    cells: Sequence[Outcomes], rng: np.random.Generator, permutations: int = 9999
) -> PermutationTest:
    """Sum of Q over cells against that with each thread's replicates permuted within their sequences.

    The same permutation in all cells, since a replicate is the same draw in all. With fewer than 20 sequences
    in which B and a thread's failure vary there is no verdict: the outcome of a sequence is determined.
    """
    threads, count = cells[0].threads, int(sum(_telling(cell) for cell in cells))
    x = np.stack([cell.columns for cell in cells])  # (cells, 1 + n, W, S, K)
    cells_, columns, worlds, sequences, replicates = x.shape
    x = x.reshape(cells_, columns, worlds * sequences, replicates)
    valid = np.isfinite(x).all(axis=(0, 1))
    weight = _weights(valid.reshape(worlds, sequences, replicates)).reshape(valid.shape)
    x = np.where(valid, x, 0.0)
    observed = float((x.prod(axis=1) * weight).sum())
    if count < _LEAST_TELLING:
        return PermutationTest(observed, None, None, count)
    moved = np.empty(permutations)
    for i in range(permutations):
        product = x[:, 0].copy()
        for j in range(threads):
            # Valid replicates in random order first, then the void ones, whose weight is 0 anyway.
            order = np.argsort(np.where(valid, rng.random(valid.shape), 2.0), axis=1)
            slot = np.argsort(np.where(valid, np.arange(replicates), replicates), axis=1, kind="stable")
            target = np.empty_like(order)
            np.put_along_axis(target, slot, order, axis=1)
            product *= np.take_along_axis(x[:, 1 + j], np.broadcast_to(target, product.shape), axis=2)
        moved[i] = (product * weight).sum()
    return PermutationTest(observed, float(moved.mean()), _two_sided(observed, moved), count)


def _two_sided(observed: float, moved: Floats) -> float:
    slack = 1e-12 * max(1.0, abs(observed))
    up = (1 + int((moved >= observed - slack).sum())) / (1 + len(moved))
    low = (1 + int((moved <= observed + slack).sum())) / (1 + len(moved))
    return min(1.0, 2 * min(up, low))


def _moved(columns: Floats, others: Sequence[np.ndarray]) -> Floats:
    """(P,) Q of (1 + n, W, S, K) columns where R_j comes from the worlds (P, W) that others say."""
    product = columns[0]
    for column, worlds in zip(columns[1:], others, strict=True):
        product = product * column[worlds]
    return np.nan_to_num(world_means(product)).mean(axis=1)


def _weights(valid: np.ndarray) -> Floats:
    """(W, S, K) weight of each valid replicate: worlds alike, then sequences, then replicates."""
    replicates = valid.sum(axis=2, keepdims=True)
    sequences = (replicates > 0).sum(axis=1, keepdims=True)
    worlds = max(int((sequences > 0).sum()), 1)
    return np.where(valid, 1.0 / np.maximum(replicates * sequences, 1) / worlds, 0.0)


def _telling(cell: Outcomes) -> int:
    """Sequences in which both B and some R_j take both values."""

    def varies(x: Floats) -> np.ndarray:
        known = np.isfinite(x)
        return np.where(known, x, 0.0).max(axis=-1) > np.where(known, x, 1.0).min(axis=-1)

    return int((varies(cell.breakage) & varies(cell.thread_failures).any(axis=0)).sum())
