"""Outcomes of one cell: replicates of sequences of worlds, the same in every cell of an experiment."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Outcomes:
    """0/1 outcomes of the units of one cell; W worlds of S sequences of K replicates.

    Attributes:
        breakage: (W, S, K) B of the free arm; NaN for a void replicate or one that was never run.
        thread_failures: (n, W, S, K) R_j of the crossing arm, in the order J of the threads.
        dual_failures: (n, W, S, K) D_J of the free arm for the first 1 to n threads of J.
    """

    breakage: Floats
    thread_failures: Floats
    dual_failures: Floats

    @property
    def threads(self) -> int:
        """Number n of threads."""
        return len(self.thread_failures)

    @property
    def columns(self) -> Floats:
        """(1 + n, W, S, K) factors of Eq. 1: B and R_1 to R_n."""
        return np.concatenate([self.breakage[None], self.thread_failures])

    def of_first(self, threads: int) -> "Outcomes":
        """Only the first threads, and only the sequences that have enough replicates for them.

        A sequence needs ``threads`` + 1 valid replicates, unless the design has fewer for all of them.
        """
        valid = np.isfinite(self.breakage).sum(axis=2, keepdims=True)
        enough = valid > min(threads, self.breakage.shape[2] - 1)
        kept = [
            np.where(enough, x, np.nan)
            for x in (self.breakage, self.thread_failures[:threads], self.dual_failures[:threads])
        ]
        return Outcomes(*kept)

    def of_worlds(self, worlds: NDArray[np.bool_]) -> "Outcomes":
        """Only some of the worlds, (W,) bool."""
        return replace(
            self,
            breakage=self.breakage[worlds],
            thread_failures=self.thread_failures[:, worlds],
            dual_failures=self.dual_failures[:, worlds],
        )

    def placed(self, at: NDArray[np.intp], shape: tuple[int, int, int]) -> "Outcomes":
        """The worlds at the places (W,) among those of a larger shape (W, S, K), NaN elsewhere."""

        def grown(x: Floats) -> Floats:
            larger = np.full((*x.shape[:-3], *shape), np.nan)
            larger[..., at, : x.shape[-2], : x.shape[-1]] = x
            return larger

        return Outcomes(grown(self.breakage), grown(self.thread_failures), grown(self.dual_failures))

    @property
    def has_units(self) -> NDArray[np.bool_]:
        """(W,) worlds with at least one valid replicate."""
        return np.asarray(np.isfinite(self.breakage).any(axis=(1, 2)))


def sequence_means(outcome: Floats) -> Floats:
    """(..., W, S) means over the valid replicates of (..., W, S, K); NaN for none."""
    return _mean_of_valid(outcome)


def world_means(outcome: Floats) -> Floats:
    """(..., W) means over the sequences of the means over their replicates; NaN for a world without any."""
    return _mean_of_valid(_mean_of_valid(outcome))


def _mean_of_valid(x: Floats) -> Floats:
    valid = np.isfinite(x)
    count = valid.sum(axis=-1)
    total = np.where(valid, x, 0.0).sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
