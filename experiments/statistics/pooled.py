"""Figures over several cells: over all of them, and over those of one kind of world.

Cells of one kind of world are paired by their worlds; kinds of world are independent samples, also where
their worlds have the same seeds.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dslab.experiments.statistics import estimates
from dslab.experiments.statistics.estimates import Figure, mean_over_cells
from dslab.experiments.statistics.formulas import FORMULAS, FormulaScore, compare_formulas, second_thread_gain
from dslab.experiments.statistics.from_records import HomogeneousCell
from dslab.experiments.statistics.judged import JudgedCell
from dslab.experiments.statistics.outcomes import Floats, Outcomes, World, world_means
from dslab.experiments.statistics.permutations import within_sequences
from dslab.experiments.statistics.verdicts import Verdict
from dslab.experiments.statistics.world_intervals import Interval, difference_interval, share_interval


@dataclass(frozen=True)
class Level:
    """Figures over all cells with n recovery threads, cells weighted alike, in each its worlds alike.

    Attributes:
        n: number of threads.
        cells: their number, of those with enough worlds for Eq. 1.
        eq1: pi_marg.
        in_worlds, in_sequences: pi_world and pi_seq; None where a cell has too few sequences or replicates.
        in_units: Q, the factors at once in one unit of the crossing arm.
        measured: D, dual failures of the free arm.
        first_alone: D of the first thread alone, of the same units.
    """

    n: int
    cells: int
    eq1: float | None
    in_worlds: float | None
    in_sequences: float | None
    in_units: float | None
    measured: float | None
    first_alone: float | None


@dataclass(frozen=True)
class KindOfWorld:
    """One kind of world with n recovery threads, over the cells that no n finds saturated, weighted alike.

    Attributes:
        world, n: which one.
        worlds: their number.
        cells, saturated: numbers of cells that are in the figures, and that are left out as saturated.
        eq1, weakest: means over the cells; None with too few worlds.
        measured: D, mean over the cells, of the worlds of each; None if all are saturated.
    """

    world: str
    n: int
    worlds: int
    cells: int
    saturated: int
    eq1: float | None
    weakest: float | None
    measured: Interval | None


@dataclass(frozen=True)
class WithinSequences:
    """The test within sequences, summed over cells.

    Attributes:
        n: number of threads.
        cells, telling: numbers of cells, and of their sequences that enter and in which B and a thread's
            failure both vary.
        ratio: Q over its mean over the permutations.
        p: two-sided; None with too few telling sequences: the outcome of a sequence is determined.
    """

    n: int
    cells: int
    telling: int
    ratio: float | None
    p: float | None


@dataclass(frozen=True)
class Formulas:
    """Formulas scored on worlds that they have not seen: means over cells, weighted alike.

    Attributes:
        n: number of threads.
        cells: (name, kind of world) of each, in the order of the calibrations.
        worlds: their number, over all kinds.
        on_dual_failures, on_units: scores on D and on Q; none of a formula that no cell could be fitted to.
        second_thread: D of the first thread alone minus D of all n, on the same units; None for n = 1.
    """

    n: int
    cells: tuple[tuple[str, str], ...]
    worlds: int
    on_dual_failures: tuple[FormulaScore, ...]
    on_units: tuple[FormulaScore, ...]
    second_thread: Interval | None


def level(cells: Sequence[HomogeneousCell], n: int) -> Level | None:
    """Pool all cells with the first n threads; None if none has enough worlds."""
    each = [outcomes for cell in cells if len((outcomes := cell.usable(n)).breakage) > 1 + n]

    def mean(of: Callable[[Outcomes], Figure | None]) -> float | None:
        values = [figure.value for figure in map(of, each) if figure is not None]
        return float(np.mean(values)) if len(values) == len(each) else None

    figures = (
        estimates.product_of_margins,
        estimates.product_in_worlds,
        estimates.product_in_sequences,
        estimates.measured_in_units,
        estimates.dual_failure,
        lambda outcomes: estimates.share(outcomes.dual_failures[0]),
    )
    return Level(n, len(each), *map(mean, figures)) if each else None


def by_world(cells: Sequence[HomogeneousCell], outcomes: Sequence[Floats]) -> Floats:
    """(W,) mean over the cells of each world's mean, in whatever cells it is."""
    means: dict[World, list[float]] = {}
    for cell, outcome in zip(cells, outcomes, strict=True):
        for world, mean in zip(cell.outcomes.worlds, world_means(outcome), strict=True):
            if np.isfinite(mean):
                means.setdefault(world, []).append(float(mean))
    return np.asarray([np.mean(of_world) for of_world in means.values()], dtype=np.float64)


def kind_of_world(
    cells: Sequence[HomogeneousCell], judged: Sequence[JudgedCell], world: str, n: int
) -> KindOfWorld:
    """Pool the cells of a kind of world that no number of threads finds saturated."""
    own = [cell for cell in cells if cell.world == world]
    saturated = {c.cell for c in judged if c.world == world and c.saturated}
    told = [c for c in judged if (c.world, c.n) == (world, n) and c.cell not in saturated]
    kept = [cell.usable(n) for cell in own if cell.name in {c.cell for c in told}]
    known = bool(told) and all(c.eq1 is not None for c in told)
    measured = [world_means(outcomes.dual_failures[-1]) for outcomes in kept]
    return KindOfWorld(
        world=world,
        n=n,
        worlds=len({int(seed) for cell in own for seed in cell.worlds}),
        cells=len(kept),
        saturated=len(saturated),
        eq1=float(np.mean([c.eq1 for c in told])) if known else None,
        weakest=float(np.mean([c.weakest for c in told])) if known else None,
        measured=share_interval(mean_over_cells(measured, [o.worlds for o in kept])) if kept else None,
    )


def permuted_within(
    cells: Sequence[HomogeneousCell], n: int, rng: np.random.Generator, permutations: int
) -> list[WithinSequences]:
    """Test independence within the sequences of all cells at once; nothing without repeats."""
    if max((cell.shape[2] for cell in cells), default=1) < 2:  # no repeats
        return []
    test = within_sequences([cell.outcomes.of_first(n) for cell in cells], rng, permutations)
    ratio = test.statistic / test.expected if test.expected else None
    return [WithinSequences(n, len(cells), test.telling or 0, ratio, test.p)]


def score_formulas(cells: Sequence[HomogeneousCell], judged: Sequence[JudgedCell], n: int) -> list[Formulas]:
    """Score the formulas on all cells with enough worlds for Eq. 1; nothing without one, or without D."""
    of = {(c.cell, c.world): c for c in judged if c.n == n and c.eq1 is not None}
    told = {key: cell.usable(n) for cell in cells if (key := (cell.name, cell.world)) in of}
    each = list(told.values())
    if not sum(np.nansum(o.dual_failures[-1]) for o in each):
        return []
    fitted = [of[key].verdict_in_units != Verdict.UNTESTED and not of[key].saturated for key in told]
    # Without a cell to fit them to, the factors are 0 and the formulas Eq. 1.
    names = [name for name in FORMULAS if any(fitted) or name not in ("beta factor", "one factor")]
    scores = (tuple(s for s in found if s.name in names) for found in compare_formulas(each, fitted))
    worlds = [o.worlds for o in each]
    gain = mean_over_cells([second_thread_gain(o) for o in each], worlds) if n > 1 else None
    return [
        Formulas(
            n,
            tuple(told),
            len({world for own in worlds for world in own}),
            *scores,
            difference_interval(gain) if gain else None,
        )
    ]
