"""Proofs of the boundary search: simulated systems with planted curves, and how often the answer is right."""

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, inf, log

import numpy as np

from dslab.experiments.statistics.boundary import SHAM, Boundary, curve_grid

STRENGTHS = tuple(np.linspace(0.0, log(80.0), 20).tolist())
"""Doses of the simulated stress, whose strongest is 80 times its weakest."""
TRIALS, SHAMS, BATCH = 60, 8, 4


@dataclass(frozen=True)
class Planted:
    """A simulated system: its probability of failure is g + (a - g) logistic(s (u - x)).

    Attributes:
        middle, slope: x and s.
        ceiling, sham_rate: a and g.
    """

    middle: float
    slope: float
    ceiling: float = 1.0
    sham_rate: float = 0.0

    def failure(self, strength: float) -> float:
        """Probability of failure at a strength; minus infinite for none."""
        rise = 0.0 if strength == -inf else 1.0 / (1.0 + exp(-self.slope * (strength - self.middle)))
        return self.sham_rate + (self.ceiling - self.sham_rate) * rise

    def reaching(self, level: float) -> float:
        """Strength at which it reaches a probability; infinite if none does."""
        if level >= self.ceiling:
            return inf
        return self.middle + log((level - self.sham_rate) / (self.ceiling - level)) / self.slope


REACHED = (
    (Planted(2.2, 3.0), 0.5),
    (Planted(2.6, 8.0, 0.9, 0.03), 0.5),
    (Planted(1.5, 1.5, 1.0, 0.05), 0.5),
    (Planted(2.4, 4.0, 0.7), 0.5),
    (Planted(3.2, 3.0, 0.9), 0.25),
    (Planted(1.8, 5.0, 0.8, 0.1), 0.5),
    (Planted(2.0, 3.0), 0.9),
)
"""Systems, some off the grid, and levels that they reach."""
NOT_REACHED = ((Planted(2.0, 3.0, 0.3), 0.5), (Planted(1.5, 3.0, 0.5), 0.7), (Planted(2.2, 8.0, 0.05), 0.5))
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


def answer(planted: Planted, level: float, rng: np.random.Generator) -> Boundary:
    """The boundary that a search finds of a simulated system."""
    grid = curve_grid(STRENGTHS)
    trials = search(lambda strength: bool(rng.random() < planted.failure(strength)))
    return grid.boundary(grid.posterior(*trials), level)


def covers(planted: Planted, level: float, rng: np.random.Generator) -> float:
    """1 if the interval holds the dose at which the system reaches the level, else 0."""
    found = answer(planted, level, rng)
    return float(found.low <= planted.reaching(level) <= found.high)


def not_reached(planted: Planted, level: float, rng: np.random.Generator) -> float:
    """1 if the answer is that no dose reaches the level, else 0."""
    return float(answer(planted, level, rng).median > STRENGTHS[-1])
