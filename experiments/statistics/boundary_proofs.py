"""Proofs of the boundary search: simulated systems with planted curves, and how often the answer is right."""

from collections.abc import Callable
from math import inf, log

import numpy as np

from dslab.experiments.statistics.boundary import SHAM, Boundary, Curves, curve_grid

STRENGTHS = tuple(np.linspace(0.0, log(80.0), 20).tolist())
"""Doses of the simulated stress, whose strongest is 80 times its weakest."""
TRIALS, SHAMS, BATCH = 60, 8, 4


REACHED = (
    (Curves(2.2, 3.0), 0.5),
    (Curves(2.6, 8.0, 0.9, 0.03), 0.5),
    (Curves(1.5, 1.5, 1.0, 0.05), 0.5),
    (Curves(2.4, 4.0, 0.7), 0.5),
    (Curves(3.2, 3.0, 0.9), 0.25),
    (Curves(1.8, 5.0, 0.8, 0.1), 0.5),
    (Curves(2.0, 3.0), 0.9),
)
"""Simulated systems, each a single curve, some off the grid, and levels that they reach."""
NOT_REACHED = ((Curves(2.0, 3.0, 0.3), 0.5), (Curves(1.5, 3.0, 0.5), 0.7), (Curves(2.2, 8.0, 0.05), 0.5))
"""Systems, and levels above their ceilings."""


def search(
    fails: Callable[[float], bool], trials: int = TRIALS, strengths: tuple[float, ...] = STRENGTHS
) -> tuple[list[int], list[bool]]:
    """Search by shams, then batches, as a schedule does.

    Args:
        fails: runs a trial at a strength, minus infinite for a sham.
        trials: their number, with the shams.
        strengths: of the doses.

    Returns:
        Number of the dose of every trial, or SHAM, and whether it failed.
    """
    grid = curve_grid(strengths)
    places, failed = [SHAM] * SHAMS, [fails(-inf) for _ in range(SHAMS)]
    while len(places) < trials:
        chosen = grid.choose(grid.posterior(places, failed), BATCH)
        places += chosen
        failed += [fails(strengths[place]) for place in chosen]
    return places[:trials], failed[:trials]


def answer(planted: Curves, level: float, rng: np.random.Generator) -> Boundary:
    """The boundary that a search finds of a simulated system."""
    grid = curve_grid(STRENGTHS)
    trials = search(lambda strength: bool(rng.random() < planted.failure(strength)[0]))
    return grid.boundary(grid.posterior(*trials), level)


def covers(planted: Curves, level: float, rng: np.random.Generator) -> float:
    """1 if the interval holds the dose at which the system reaches the level, else 0."""
    found = answer(planted, level, rng)
    return float(found.low <= float(planted.reaching(level)) <= found.high)


def not_reached(planted: Curves, level: float, rng: np.random.Generator) -> float:
    """1 if the answer is that no dose reaches the level, else 0."""
    return float(answer(planted, level, rng).median > STRENGTHS[-1])
