"""What the tests of a run would say on its own margins: experiments that are drawn as its records are."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from dslab.experiments.statistics.difficulties import (
    NODES,
    WEIGHTS,
    Counts,
    Margin,
    common_correlation,
    fit_margin,
    smoothing,
)
from dslab.experiments.statistics.outcomes import Floats, Outcomes
from dslab.experiments.statistics.permutations import independence, within_sequences
from dslab.experiments.statistics.verdicts import LEVEL, compare_forecast, compare_units, verdicts


@dataclass(frozen=True)
class ExchangePower:
    """How often the test within sequences sees that some runs decide all events by one draw.

    Attributes:
        shared: share of these runs.
        telling: mean number of telling sequences.
        power: share of the experiments with p <= .05.
        error: standard error of the power.
    """

    shared: float
    telling: float
    power: float
    error: float


@dataclass(frozen=True)
class RehearsedWords:
    """Verdicts on one cell with its first threads if Eq. 1 is true.

    Attributes:
        n: number of threads.
        on_units, on_dual_failures: verdicts on Q and D, with their shares of the experiments.
    """

    n: int
    on_units: dict[str, float]
    on_dual_failures: dict[str, float]


def exchange_power(
    cells: Sequence[Outcomes],
    shared: float,
    rng: np.random.Generator,
    experiments: int = 400,
    permutations: int = 399,
) -> ExchangePower:
    """Simulate the test within sequences on the chances of each sequence of a run.

    A sequence's chances are drawn anew in each experiment from what its own replicates leave open, by the
    probit model of its cell with one correlation of all difficulties. Its runs share nothing else, but for a
    share of them in which one uniform number decides B and the failure of every thread.

    Args:
        cells: with the threads of the test.
        shared: share of the runs with one draw.
        rng: of all draws.
        experiments, permutations: their numbers.
    """
    chances = [_Chances.of(cell.columns) for cell in cells]
    tests = []
    for _ in range(experiments):
        drawn = [_with_shared_runs(cell, of, shared, rng) for cell, of in zip(cells, chances, strict=True)]
        tests.append(within_sequences(drawn, rng, permutations))
    power = float(np.mean([test.p is not None and test.p <= LEVEL for test in tests]))
    telling = float(np.mean([test.telling for test in tests]))
    return ExchangePower(shared, telling, power, sqrt(power * (1 - power) / experiments))


def rehearse_words(
    tests: Sequence[tuple[Outcomes, int]],
    rng: np.random.Generator,
    experiments: int = 400,
    permutations: int = 999,
) -> list[RehearsedWords]:
    """Judge experiments in which Eq. 1 is true, with the shares, difficulties, worlds and repeats of a run.

    B, every R_j of the crossing arm and every one of the free arm are drawn independently of each other, but
    for the difficulty of a sequence for a thread, which is that of both arms.

    Args:
        tests: cells and their numbers of threads, of one family in Holm's correction.
        rng: of all draws.
        experiments, permutations: their numbers.
    """
    cells = list({id(cell): cell for cell, _ in tests}.values())
    margins = {id(cell): [fit_margin(Counts.of(e[None])) for e in cell.columns] for cell in cells}
    units, duals = ([Counter() for _ in tests] for _ in range(2))
    for _ in range(experiments):
        drawn = {id(cell): _independent(cell, margins[id(cell)], rng) for cell in cells}
        each = [drawn[id(cell)].of_first(n).with_units() for cell, n in tests]
        on_units = [compare_units(o, independence(o, rng, permutations)) for o in each]
        for counts, found in zip(
            (units, duals), verdicts(on_units, [compare_forecast(o) for o in each]), strict=True
        ):
            for count, verdict in zip(counts, found, strict=True):
                count[str(verdict)] += 1
    return [
        RehearsedWords(n, *({v: k / experiments for v, k in c.items()} for c in (q, d)))
        for (_, n), q, d in zip(tests, units, duals, strict=True)
    ]


@dataclass(frozen=True)
class _Chances:
    """What is known of the chances of all events in a run of each sequence of a cell.

    Attributes:
        chance: (events, nodes) increasing.
        common: (nodes, sequences) distribution functions of what is common of the difficulties.
        own: (events, nodes, nodes, sequences) those of each difficulty, given that.
    """

    chance: Floats
    common: Floats
    own: Floats

    @classmethod
    def of(cls, columns: Floats) -> "_Chances":
        """Of (events, W, S, K) outcomes."""
        counts = Counts.of(columns)
        margins = [fit_margin(counts.only(event)) for event in range(len(columns))]
        correlation = common_correlation([(counts, margins)])
        runs = np.isfinite(columns).all(axis=0).sum(axis=-1).ravel()
        each = np.nansum(columns, axis=-1).reshape(len(columns), -1)
        chance = np.stack([margin.in_runs(NODES) for margin in margins])
        p = chance[..., None]
        alone = p ** each[:, None] * (1 - p) ** (runs - each)[:, None]
        own = smoothing(correlation)[None, :, :, None] * alone[:, None]
        common = WEIGHTS[:, None] * own.sum(axis=2).prod(axis=0)
        return cls(chance, _distribution(common, 0), _distribution(own, 2))

    def draw(self, rng: np.random.Generator) -> Floats:
        """(events, sequences) chances."""
        sequences = np.arange(self.common.shape[1])
        at = _node(self.common, rng)
        return np.stack(
            [p[_node(own[at, :, sequences].T, rng)] for p, own in zip(self.chance, self.own, strict=True)]
        )


def _distribution(weights: Floats, axis: int) -> Floats:
    below = np.cumsum(weights, axis=axis)
    return below / np.maximum(np.take(below, [-1], axis=axis), 1e-300)


def _node(distribution: Floats, rng: np.random.Generator) -> np.ndarray:
    """(sequences,) nodes drawn by their (nodes, sequences) distribution functions."""
    return (distribution[:-1] < rng.random(distribution.shape[1])).sum(axis=0)


def _with_shared_runs(cell: Outcomes, chances: _Chances, shared: float, rng: np.random.Generator) -> Outcomes:
    shape = cell.columns.shape
    p = chances.draw(rng).reshape(*shape[:3], 1)
    uniform = rng.random(shape)
    uniform = np.where(rng.random(shape[1:]) < shared, uniform[0], uniform)
    return _outcomes(cell, uniform < p, uniform < p)


def _independent(cell: Outcomes, margins: Sequence[Margin], rng: np.random.Generator) -> Outcomes:
    shape = cell.columns.shape
    p = np.stack([m.in_runs(rng.normal(size=shape[1:3])) for m in margins])[..., None]
    return _outcomes(cell, rng.random(shape) < p, rng.random(shape) < p)


def _outcomes(cell: Outcomes, crossing: np.ndarray, free: np.ndarray) -> Outcomes:
    """Outcomes of both arms, where the cell has a run that counts."""
    dual = crossing[0] & np.logical_and.accumulate(free[1:], axis=0)
    drawn = Outcomes(*(x.astype(float) for x in (crossing[0], crossing[1:], dual)), cell.worlds)
    return drawn.where(np.isfinite(cell.breakage))
