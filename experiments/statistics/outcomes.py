"""Outcomes of one cell: replicates of sequences of worlds, the same in every cell of an experiment."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
World = tuple[str, int]
"""A world by its kind and its seed."""


@dataclass(frozen=True)
class Outcomes:
    """0/1 outcomes of the units of one cell; W worlds of S sequences of K replicates.

    Attributes:
        breakage: (W, S, K) B of the free arm; NaN for a void replicate or one that was never run.
        thread_failures: (n, W, S, K) R_j of the crossing arm, in the order J of the threads.
        dual_failures: (n, W, S, K) D_J of the free arm for the first 1 to n threads of J.
        worlds: (W,) the worlds; numbers of one kind if left out.
    """

    breakage: Floats
    thread_failures: Floats
    dual_failures: Floats
    worlds: Sequence[World] = ()

    def __post_init__(self) -> None:
        if not self.worlds:
            object.__setattr__(self, "worlds", [("", i) for i in range(len(self.breakage))])

    @property
    def threads(self) -> int:
        """Number n of threads."""
        return len(self.thread_failures)

    @property
    def columns(self) -> Floats:
        """(1 + n, W, S, K) factors of Eq. 1: B and R_1 to R_n."""
        return np.concatenate([self.breakage[None], self.thread_failures])

    @property
    def margins(self) -> tuple[float, ...]:
        """Shares of B and R_1 to R_n, worlds weighted alike."""
        return tuple(map(float, world_means(self.columns).mean(axis=1)))

    def of_first(self, threads: int) -> "Outcomes":
        """Only the first threads, and only the sequences that have enough replicates for them.

        A sequence needs ``threads`` + 1 valid replicates, unless the design has fewer for all of them.
        """
        valid = np.isfinite(self.breakage).sum(axis=2, keepdims=True)
        return self.first(threads).where(valid > min(threads, self.breakage.shape[2] - 1))

    def first(self, threads: int) -> "Outcomes":
        """Only the first threads, in all units."""
        return Outcomes(
            self.breakage, self.thread_failures[:threads], self.dual_failures[:threads], self.worlds
        )

    def where(self, kept: NDArray[np.bool_]) -> "Outcomes":
        """Only some of the units, (W, S, K) bool."""
        each = (self.breakage, self.thread_failures, self.dual_failures)
        return Outcomes(*(np.where(kept, x, np.nan) for x in each), self.worlds)

    def with_units(self) -> "Outcomes":
        """Only the worlds with at least one valid replicate."""
        kept = np.isfinite(self.breakage).any(axis=(1, 2))
        worlds = [world for world, has in zip(self.worlds, kept, strict=True) if has]
        return Outcomes(
            self.breakage[kept], self.thread_failures[:, kept], self.dual_failures[:, kept], worlds
        )

    def placed(self, worlds: Sequence[World], sequences: int, replicates: int) -> "Outcomes":
        """The same among more worlds, sequences and replicates, NaN where there is none."""
        at = [worlds.index(world) for world in self.worlds]

        def grown(x: Floats) -> Floats:
            larger = np.full((*x.shape[:-3], len(worlds), sequences, replicates), np.nan)
            larger[..., at, : x.shape[-2], : x.shape[-1]] = x
            return larger

        return Outcomes(grown(self.breakage), grown(self.thread_failures), grown(self.dual_failures), worlds)


def sequence_means(outcome: Floats) -> Floats:
    """(..., W, S) means over the valid replicates of (..., W, S, K); NaN for none."""
    valid = np.isfinite(outcome)
    count = valid.sum(axis=-1)
    total = np.where(valid, outcome, 0.0).sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def world_means(outcome: Floats) -> Floats:
    """(..., W) means over the sequences of the means over their replicates; NaN for a world without any."""
    return sequence_means(sequence_means(outcome))
