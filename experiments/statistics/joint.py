"""Joint outcomes of units, free arm by crossing arm: the table behind every test of Eq. 1.

A unit has one of three states in the free arm (no breakage; breakage, recovered; D_n) and one of the 2ⁿ
patterns of R_1 … R_n in the crossing arm. Both arms see the same images, so that their outcomes are
dependent: units are drawn whole.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NO_BREAKAGE, RECOVERED, DUAL_FAILURE = 0, 1, 2

_PRIOR_UNITS = 4.0

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


def patterns(threads: int) -> Bools:
    """(2ⁿ, n) failed threads of each pattern; thread j is bit j - 1 of the pattern's number."""
    return (np.arange(2**threads)[:, None] >> np.arange(threads)[None, :] & 1).astype(bool)


@dataclass(frozen=True)
class JointCounts:
    """Units counted by both arms' outcomes.

    Attributes:
        table: (3, 2ⁿ) counts; rows are the free arm's states, columns the `patterns` of the crossing arm.
    """

    table: Ints

    @classmethod
    def of_units(cls, breakage: Bools, dual_failure: Bools, crossings: Bools) -> "JointCounts":
        """Count units: (N,) B, (N,) D_n, (N, n) R_j; D_n without B is counted as no breakage."""
        threads = crossings.shape[1]
        state = np.where(breakage, np.where(dual_failure, DUAL_FAILURE, RECOVERED), NO_BREAKAGE)
        pattern = (crossings * (1 << np.arange(threads))).sum(axis=1).astype(int)
        flat = np.bincount(state * 2**threads + pattern, minlength=3 * 2**threads)
        return cls(flat.reshape(3, 2**threads))

    @property
    def threads(self) -> int:
        """Number n of recovery threads."""
        return int(self.table.shape[1]).bit_length() - 1

    @property
    def margins(self) -> "Margins":
        """The counts that Eq. 1 relates, as a batch of one."""
        return margins_of(self.table[None])


@dataclass(frozen=True)
class Margins:
    """The counts that Eq. 1 relates, for a batch of M experiments.

    Attributes:
        units: (M,) units.
        breakages: (M,) with B.
        failures: (M,) with D_n.
        crossings: (M, n) with R_j.
    """

    units: Floats
    breakages: Floats
    failures: Floats
    crossings: Floats


def margins_of(tables: NDArray) -> Margins:
    """Margins of a batch (M, 3, 2ⁿ) of tables."""
    threads = int(tables.shape[2]).bit_length() - 1
    rows = tables.sum(axis=2).astype(float)
    crossings = tables.sum(axis=1).astype(float) @ patterns(threads).astype(float)
    return Margins(rows.sum(axis=1), rows[:, 1] + rows[:, 2], rows[:, 2], crossings)


def independent(states: Floats, failed: Floats) -> Floats:
    """(3, 2ⁿ) distribution with independent arms, from (3,) states of the free arm and (n,) P(R_j)."""
    pattern = np.prod(np.where(patterns(failed.size), failed, 1 - failed), axis=1)
    return states[:, None] * pattern[None, :]


def raked(table: NDArray, states: Floats, failed: Floats, cycles: int = 30) -> Floats:
    """The distribution with given margins that keeps the observed pairing of the arms.

    Iterative proportional fitting keeps every odds ratio of the table. Four units' worth of independent
    outcomes are added first: an unobserved pattern is rare, not impossible, and a few units that agree by
    chance do not count as certain pairing.

    Args:
        table: (3, 2ⁿ) counts.
        states: (3,) probabilities of the free arm's states, sum 1.
        failed: (n,) probabilities of R_j.
        cycles: of the fitting.

    Returns:
        (3, 2ⁿ) probabilities.

    Source: Deming & Stephan, Annals of Mathematical Statistics 1940.
    """
    pattern = patterns(failed.size)
    found = np.asarray(table, float) + _PRIOR_UNITS * independent(states, failed)
    found /= found.sum()
    for _ in range(cycles):
        found *= _share(states, found.sum(axis=1))[:, None]
        for thread, wanted in enumerate(failed):
            hit = pattern[:, thread]
            has = found[:, hit].sum()
            factors = _share(np.array([1 - wanted, wanted]), np.array([found.sum() - has, has]))
            found *= np.where(hit, factors[1], factors[0])[None, :]
    return found / found.sum()


def draw_tables(rng: np.random.Generator, probabilities: Floats, units: int, batch: int) -> Ints:
    """Draw (batch, 3, 2ⁿ) counts: a batch of experiments of so many units each."""
    drawn = rng.multinomial(units, probabilities.ravel(), size=batch)
    return drawn.reshape(batch, *probabilities.shape)


def _share(wanted: Floats, has: Floats) -> Floats:
    return np.divide(wanted, has, out=np.zeros_like(has), where=has > 0)
