"""Experiments with known answers, on which the statistics are proved and their power is reckoned."""

from dataclasses import dataclass

import numpy as np

from dslab.experiments.statistics.outcomes import Floats, Outcomes


@dataclass(frozen=True)
class Truth:
    """A simulated cell: shares, and what they vary with.

    Attributes:
        shares: (n + 1,) expectations of B and R_1 to R_n.
        correlation: ICC of every outcome within a world, in [0, 1]: 0 for chance alone, 1 for outcomes that
            the world determines.
        common: share of worlds, and of runs, in which one draw decides all outcomes alike.
        arms: chance that the free arm repeats the outcome of a thread in the crossing arm, else drawn anew.
    """

    shares: tuple[float, ...]
    correlation: float = 0.0
    common: float = 0.0
    arms: float = 1.0


def simulate(
    truth: Truth,
    rng: np.random.Generator,
    worlds: int,
    sequences: int = 1,
    replicates: int = 1,
    void: float = 0.0,
) -> Outcomes:
    """Draw a cell of W worlds, S sequences and K replicates, of which a share is void."""
    shape = (len(truth.shares), worlds, sequences, replicates)
    uniform = _uniform(rng, shape, truth.correlation)
    shared = _uniform(rng, (1, *shape[1:]), truth.correlation)
    uniform = np.where(rng.random((1, worlds, 1, 1)) < truth.common, shared, uniform)
    x = (uniform < np.asarray(truth.shares)[:, None, None, None]).astype(float)
    again = (rng.random(shape) < np.asarray(truth.shares)[:, None, None, None]).astype(float)
    free = np.where(rng.random(shape) < truth.arms, x, again)
    dual = x[0] * np.cumprod(free[1:], axis=0)
    lost = rng.random(shape[1:]) < void
    return Outcomes(*(np.where(lost, np.nan, each) for each in (x[0], x[1:], dual)))


def _uniform(rng: np.random.Generator, shape: tuple[int, ...], correlation: float) -> Floats:
    """Uniform draws of (C, W, S, K) that are, with the probability ``correlation``, the world's own."""
    own = rng.random((*shape[:2], 1, 1))
    return np.where(rng.random(shape) < np.sqrt(correlation), own, rng.random(shape))
