"""Tests of independence that permute outcomes: whole worlds, or replicates within their sequences."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dslab.experiments.statistics.outcomes import Floats, Outcomes, world_means

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

    The replicates of a world stay together, so that the test holds at any correlation within worlds. Valid
    ones come first in their sequences, and sequences with any in their worlds, so that moved units meet some.
    """
    columns = _valid_first(outcomes.with_units().columns)
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

    The same permutation in all cells of a kind of world, since a replicate is the same draw in all of them; a
    replicate that is void in one cell is left out of all that have its sequence. Kinds of world are permuted
    each for itself. With fewer than 20 sequences in which B and a thread's failure vary over the replicates
    that enter, there is no verdict: the outcome of a sequence is determined.
    """
    kinds: dict[str, list[Outcomes]] = {}
    for cell in cells:
        kinds.setdefault(cell.worlds[0][0], []).append(cell)
    groups = [_Replicates.of(of_kind) for of_kind in kinds.values()]
    observed, count = sum(each.observed for each in groups), sum(each.telling for each in groups)
    if count < _LEAST_TELLING:
        return PermutationTest(observed, None, None, count)
    moved = np.array([sum(each.permuted(rng) for each in groups) for _ in range(permutations)])
    return PermutationTest(observed, float(moved.mean()), _two_sided(observed, moved), count)


@dataclass(frozen=True)
class _Replicates:
    """Replicates of the cells of one kind of world, in their sequences.

    Attributes:
        x: (cells, 1 + n, W S, K) outcomes, 0 where they do not enter.
        valid: (W S, K) replicates that enter.
        weight: (cells, W S, K) of each.
        telling: sequences of a cell in which B and some R_j take both values.
    """

    x: Floats
    valid: np.ndarray
    weight: Floats
    telling: int

    @classmethod
    def of(cls, cells: Sequence[Outcomes]) -> "_Replicates":
        worlds = sorted({world for cell in cells for world in cell.worlds})
        most = np.max([cell.breakage.shape[1:] for cell in cells], axis=0)
        x = np.stack([cell.placed(worlds, *most).columns for cell in cells])  # (cells, 1 + n, W, S, K)
        known = np.isfinite(x).all(axis=1)
        valid = (known | ~known.any(axis=3, keepdims=True)).all(axis=0)  # a cell may lack the sequence
        entering = known & valid
        x = np.where(entering[:, None], x, np.nan)
        varies = np.nan_to_num(x, nan=0.0).max(axis=-1) > np.nan_to_num(x, nan=1.0).min(axis=-1)
        telling = int((varies[:, 0] & varies[:, 1:].any(axis=1)).sum())
        weight = np.stack([_weights(entering[c]) for c in range(len(cells))])
        rows = (-1, x.shape[-1])
        return cls(
            np.nan_to_num(x).reshape(*x.shape[:2], *rows),
            valid.reshape(rows),
            weight.reshape(len(x), *rows),
            telling,
        )

    @property
    def observed(self) -> float:
        """Sum of Q over the cells."""
        return float((self.x.prod(axis=1) * self.weight).sum())

    def permuted(self, rng: np.random.Generator) -> float:
        """The same with every thread's replicates in another order within their sequences."""
        product = self.x[:, 0].copy()
        for j in range(1, self.x.shape[1]):
            # Valid replicates in random order first, then the void ones, whose weight is 0 anyway.
            order = np.argsort(np.where(self.valid, rng.random(self.valid.shape), 2.0), axis=1)
            target = self._first + order.ravel()[self._slots]
            product *= np.take(self.x[:, j].reshape(len(product), -1), target, axis=1)
        return float((product * self.weight).sum())

    @cached_property
    def _first(self) -> np.ndarray:
        """(W S, 1) flat index of the first replicate of each sequence."""
        return np.arange(0, self.valid.size, self.valid.shape[1])[:, None]

    @cached_property
    def _slots(self) -> np.ndarray:
        """(W S, K) flat index of each replicate's place when the valid ones come first."""
        return self._first + np.argsort(np.argsort(~self.valid, axis=1, kind="stable"), axis=1)


def _two_sided(observed: float, moved: Floats) -> float:
    slack = 1e-12 * max(1.0, abs(observed))
    up = (1 + int((moved >= observed - slack).sum())) / (1 + len(moved))
    low = (1 + int((moved <= observed + slack).sum())) / (1 + len(moved))
    return min(1.0, 2 * min(up, low))


def _valid_first(columns: Floats) -> Floats:
    """(C, W, S, K) columns with the sequences and replicates of each world in another order, alike in all."""
    order = np.argsort(~np.isfinite(columns).all(axis=0), axis=2, kind="stable")
    columns = np.take_along_axis(columns, order[None], axis=3)
    order = np.argsort(np.isnan(columns[..., :1]).any(axis=0), axis=1, kind="stable")
    return np.take_along_axis(columns, order[None], axis=2)


def _moved(columns: Floats, others: Sequence[np.ndarray]) -> Floats:
    """(P,) Q of (1 + n, W, S, K) columns where R_j comes from the worlds (P, W) that others say."""
    product = columns[0]
    for column, worlds in zip(columns[1:], others, strict=True):
        product = product * column[worlds]
    return world_means(product).mean(axis=1)


def _weights(valid: np.ndarray) -> Floats:
    """(W, S, K) weight of each valid replicate: worlds alike, then sequences, then replicates."""
    replicates = valid.sum(axis=2, keepdims=True)
    sequences = (replicates > 0).sum(axis=1, keepdims=True)
    worlds = max(int((sequences > 0).sum()), 1)
    return np.where(valid, 1.0 / np.maximum(replicates * sequences, 1) / worlds, 0.0)
