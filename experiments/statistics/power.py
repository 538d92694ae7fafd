"""Planning: the power of the very tests that will judge Eq. 1, by simulated experiments."""

import math
from dataclasses import dataclass, replace

import numpy as np

from dslab.experiments.statistics.permutations import independence
from dslab.experiments.statistics.simulated import Truth, simulate
from dslab.experiments.statistics.verdicts import LEVEL, compare_forecast

MOST_WORLDS = 2000
_LEAST_WORLDS = 10  # with fewer nothing is tested


@dataclass(frozen=True)
class Design:
    """A cell to be measured.

    Attributes:
        worlds, sequences, replicates: W, of S sequences each, of K replicates each.
        correlation: ICC of every outcome within a world: the share that is difficulty, not chance.
        tests: number of tests that Holm's correction is made over.
    """

    worlds: int
    sequences: int = 1
    replicates: int = 3
    correlation: float = 0.6
    tests: int = 1


@dataclass(frozen=True)
class Power:
    """Probability that a test finds that Eq. 1 does not hold.

    Attributes:
        design: the cell.
        predicted: p0 · Π pr_j.
        measured: with the assumed ratio.
        independence, forecast: of the two tests.
        error: largest standard error of these.
    """

    design: Design
    predicted: float
    measured: float
    independence: float
    forecast: float
    error: float


def power_of(
    p0: float, pr: tuple[float, ...], ratio: float, design: Design, experiments: int = 400, seed: int = 0
) -> Power:
    """Simulate a cell many times, and test each.

    Chance that B and the threads share makes the measured failures more than Eq. 1 predicts.

    Args:
        p0, pr: shares of breakages and of each thread's failures, in (0, 1).
        ratio: measured over predicted failures, from 1 to min(p0, pr) / (p0 · Π pr).
        design: of the cell.
        experiments: number of simulations.
        seed: of the draws.

    Raises:
        ValueError: a share or the ratio is out of range.
    """
    shares = (p0, *pr)
    if not pr or not all(0 < share < 1 for share in shares):
        raise ValueError(f"p0 and pr must be between 0 and 1, are {', '.join(f'{s:g}' for s in shares)}")
    if not 0 <= design.correlation <= 1:
        raise ValueError(f"the ICC must be from 0 to 1, is {design.correlation:g}")
    predicted = math.prod(shares)
    most = min(shares) / predicted
    if not 1 <= ratio <= most:
        raise ValueError(f"the ratio must be from 1 to {most:.3g}, the weakest link's, is {ratio:g}")
    truth = Truth(shares, design.correlation, (ratio - 1) / (most - 1))
    rng, level = np.random.default_rng(seed), LEVEL / design.tests
    permutations = math.ceil(40 / level) - 1
    found = np.zeros((experiments, 2), bool)
    for each in found:
        outcomes = simulate(truth, rng, design.worlds, design.sequences, design.replicates)
        p = independence(outcomes, rng, permutations).p, compare_forecast(outcomes).p
        each[:] = [of_test is not None and of_test <= level for of_test in p]
    powers = found.mean(axis=0)
    error = float(np.sqrt(powers * (1 - powers) / experiments).max())
    return Power(design, predicted, ratio * predicted, float(powers[0]), float(powers[1]), error)


def worlds_needed(
    p0: float,
    pr: tuple[float, ...],
    ratio: float,
    power: float,
    design: Design,
    experiments: int = 400,
    seed: int = 0,
) -> Power | None:
    """The least number of worlds with which the test of independence has a power in (0, 1).

    Returns:
        The power with that number, in steps of a twentieth; None if 2,000 worlds are too few.

    Raises:
        ValueError: a share, the ratio or the power is out of range; see :func:`power_of` for the arguments.
    """
    if not 0 < power < 1:
        raise ValueError(f"power must be between 0 and 1, is {power:g}")

    def at(worlds: int, experiments: int = experiments) -> Power:
        return power_of(p0, pr, ratio, replace(design, worlds=worlds), experiments, seed)

    units = design.sequences * design.replicates * MOST_WORLDS
    # Without an effect the power is the level; without a failure, and so few are expected, nothing is found.
    if (ratio == 1 and power > LEVEL) or ratio * math.prod((p0, *pr)) * units < power:
        at(_LEAST_WORLDS, 1)  # checks the arguments
        return None
    low, high = _LEAST_WORLDS, _LEAST_WORLDS
    while (found := at(high)).independence < power:
        if high == MOST_WORLDS:
            return None
        low, high = high, min(2 * high, MOST_WORLDS)
    while high - low > max(1, high // 20):
        middle = (low + high) // 2
        tried = at(middle)
        if tried.independence >= power:
            high, found = middle, tried
        else:
            low = middle
    return found
