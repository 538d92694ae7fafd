"""The whole analysis of an experiment's records: a pure function of the table."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from experiments.statistics.by_conditions import (
    DosePoint,
    Part,
    delay_parts,
    dose_points,
    rescuable_parts,
)
from experiments.statistics.conditioning import QUANTITIES, BaselineErrors, baseline_errors, lead_ins
from experiments.statistics.direction import Direction, directions
from experiments.statistics.estimates import Figure
from experiments.statistics.formulas import FORMULAS, FormulaScore, compare_formulas, second_thread_gain
from experiments.statistics.from_records import HomogeneousCell, cells_of
from experiments.statistics.judged import JudgedCell, judge_cells, share_of_chance
from experiments.statistics.outcomes import Floats, Outcomes, world_means
from experiments.statistics.permutations import permutations_for, within_sequences
from experiments.statistics.products import product_of_distinct
from experiments.statistics.verdicts import Verdict
from experiments.statistics.world_intervals import Interval, difference_interval, share_interval


@dataclass(frozen=True)
class Level:
    """Figures over all cells with n recovery threads, cells weighted by their units.

    Attributes:
        n: number of threads.
        within_kinds: product over distinct units of a cell and kind of world: Eq. 1.
        within_worlds: product over distinct units of a world; None where a world has too few.
        in_units: Q, the factors at once in one unit of the crossing arm.
        measured: D, dual failures of the free arm.
    """

    n: int
    within_kinds: float
    within_worlds: float | None
    in_units: float
    measured: float


@dataclass(frozen=True)
class KindOfWorld:
    """One kind of world with n recovery threads, over the cells that no n finds saturated, weighted alike.

    Attributes:
        world, n: which one.
        worlds: their number.
        cells, saturated: numbers of cells that are in the figures, and that are left out as saturated.
        eq1, weakest: means over the cells; None with too few worlds.
        measured: D, mean over worlds of the means over the cells; None if all are saturated.
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
    """The test within sequences, pooled over cells of the same worlds.

    Attributes:
        n: number of threads.
        cells, telling: numbers of cells, and of sequences in which B and a thread's failure both vary.
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
    """Formulas scored on worlds that they have not seen, over cells of the same worlds.

    Attributes:
        n: number of threads.
        cells: (name, kind of world) of each, in the order of the calibrations.
        worlds: their number.
        on_dual_failures, on_units: scores on D and on Q; none of a formula that no cell could be fitted to.
        second_thread: D of the first thread alone minus D of all n, mean over cells; None for n = 1.
    """

    n: int
    cells: tuple[tuple[str, str], ...]
    worlds: int
    on_dual_failures: tuple[FormulaScore, ...]
    on_units: tuple[FormulaScore, ...]
    second_thread: Interval | None


@dataclass(frozen=True)
class Analysis:
    """Eq. 1 by an experiment's records; a part that the design does not allow is empty or None.

    Attributes:
        threads, worlds, units, void: their numbers.
        levels: per n, over all cells.
        failed_or_silent: share of the units with a dual failure of all threads or a silent failure.
        failed_or_silent_by_worlds: the same, worlds weighted alike.
        kinds_of_world: per kind of world and n.
        chance: by kind of world, 1 - ICC of B.
        cells: per n, cell and kind of world.
        within_sequences: per n.
        formulas: per n and set of worlds.
        sham: by kind of world, shares of the units without a degradation, as in ``JudgedCell.shares``.
        rescuable, delays: parts of the breakages.
        doses: shares against dose.
        directions: pr = p0, for thread `paper`.
        conditioning: pose error against baseline, for each quantity that was measured.
    """

    threads: int
    worlds: int
    units: int
    void: int
    levels: tuple[Level, ...]
    failed_or_silent: float | None
    failed_or_silent_by_worlds: Interval | None
    kinds_of_world: tuple[KindOfWorld, ...]
    chance: dict[str, Interval]
    cells: tuple[JudgedCell, ...]
    within_sequences: tuple[WithinSequences, ...]
    formulas: tuple[Formulas, ...]
    sham: dict[str, dict[str, Interval]]
    rescuable: tuple[Part, ...]
    delays: tuple[Part, ...]
    doses: tuple[DosePoint, ...]
    directions: tuple[Direction, ...]
    conditioning: tuple[BaselineErrors, ...]


def analyse(
    table: pd.DataFrame,
    threads: int,
    confirmatory: Sequence[str] = (),
    paper_thread: int | None = None,
    seed: int = 0,
    permutations: int | None = None,
) -> Analysis:
    """Analyse a table of records by kind of world, with worlds as the sample.

    Args:
        table: records, with the columns of ``records.columns``; no cell need be homogeneous.
        threads: number of recovery threads.
        confirmatory: cells named before the run.
        paper_thread: number of the thread that is Algorithm 1 to the letter, if there is one.
        seed: of the permutations.
        permutations: their number; None for as many as the number of tests takes.

    Raises:
        ValueError: no recovery thread.
    """
    if threads < 1:
        raise ValueError(f"{threads} recovery threads: Eq. 1 needs at least one")
    cells = [cell for cell in cells_of(table, threads) if cell.units]
    shams = [cell for cell in cells_of(table, threads, sham=True) if cell.units]
    rng, numbers = np.random.default_rng(seed), range(1, threads + 1)
    units = sum(cell.units for cell in cells)
    judged = judge_cells(cells, threads, confirmatory, rng, permutations)
    named = [cell for cell in cells if cell.name in confirmatory] or cells
    failed = [np.maximum(c.outcomes.dual_failures[-1], c.events("silent_failure")) for c in cells]
    kinds = list(dict.fromkeys(cell.world for cell in cells))
    chance = {world: share_of_chance([c for c in cells if c.world == world]) for world in kinds}
    tests = permutations or permutations_for(threads)
    return Analysis(
        threads=threads,
        worlds=len({(cell.world, seed) for cell in cells for seed in cell.worlds}),
        units=units,
        void=sum(cell.void for cell in cells),
        levels=tuple(_level(cells, n, units) for n in numbers) if units else (),
        failed_or_silent=sum(float(np.nansum(f)) for f in failed) / units if units else None,
        failed_or_silent_by_worlds=share_interval(_by_world(cells, failed)) if units else None,
        kinds_of_world=tuple(_kind_of_world(cells, judged, world, n) for world in kinds for n in numbers),
        chance={world: share for world, share in chance.items() if share is not None},
        cells=judged,
        within_sequences=tuple(
            test
            for n in numbers
            for group in _of_same_worlds(named)
            for test in _within(group, n, rng, tests)
        ),
        formulas=tuple(
            found
            for n in numbers
            for group in _of_same_worlds(cells)
            for found in _formulas(group, judged, n)
        ),
        sham={
            cell.world: of.shares for cell in shams for of in judge_cells([cell], threads, (), rng, 19)[-1:]
        },
        rescuable=rescuable_parts(cells),
        delays=delay_parts(cells),
        doses=dose_points(cells, shams, threads),
        directions=directions(cells, paper_thread) if paper_thread else (),
        conditioning=tuple(filter(None, (baseline_errors(lead_ins(table), q) for q in QUANTITIES))),
    )


def _level(cells: Sequence[HomogeneousCell], n: int, units: int) -> Level:
    each = [cell.outcomes.of_first(n) for cell in cells]
    counts = [cell.units for cell in cells]
    within_kinds = [float(product_of_distinct(o.columns.reshape(1 + n, -1))) for o in each]
    return Level(
        n=n,
        within_kinds=float(np.dot(counts, within_kinds)) / units,
        within_worlds=_within_worlds(each),
        in_units=sum(float(np.nansum(np.prod(o.columns, axis=0))) for o in each) / units,
        measured=sum(float(np.nansum(o.dual_failures[-1])) for o in each) / units,
    )


def _within_worlds(each: Sequence[Outcomes]) -> float | None:
    """Product over the distinct units of a world, worlds weighted by their units."""
    total = count = 0.0
    for outcomes in each:
        rows = outcomes.columns.reshape(*outcomes.columns.shape[:2], -1)
        product, valid = product_of_distinct(rows), np.isfinite(rows).all(axis=0).sum(axis=1)
        if np.isnan(product[valid > 0]).any():
            return None
        total += float((product[valid > 0] * valid[valid > 0]).sum())
        count += float(valid.sum())
    return total / count if count else None


def _by_world(cells: Sequence[HomogeneousCell], outcomes: Sequence[Floats]) -> Floats:
    """(W,) mean over the cells of each world's mean, in whatever cells it is."""
    means: dict[tuple[str, int], list[float]] = {}
    for cell, outcome in zip(cells, outcomes, strict=True):
        for seed, mean in zip(cell.worlds, world_means(outcome), strict=True):
            if np.isfinite(mean):
                means.setdefault((cell.world, int(seed)), []).append(float(mean))
    return np.asarray([np.mean(of_world) for of_world in means.values()], dtype=np.float64)


def _kind_of_world(
    cells: Sequence[HomogeneousCell], judged: Sequence[JudgedCell], world: str, n: int
) -> KindOfWorld:
    own = [cell for cell in cells if cell.world == world]
    saturated = {c.cell for c in judged if c.world == world and c.saturated}
    told = [c for c in judged if (c.world, c.n) == (world, n) and c.cell not in saturated]
    kept = [cell for cell in own if cell.name in {c.cell for c in told}]
    known = bool(told) and all(c.eq1 is not None for c in told)
    by_world = _by_world(kept, [c.outcomes.of_first(n).dual_failures[-1] for c in kept])
    return KindOfWorld(
        world=world,
        n=n,
        worlds=len({int(seed) for cell in own for seed in cell.worlds}),
        cells=len(kept),
        saturated=len(saturated),
        eq1=float(np.mean([c.eq1 for c in told])) if known else None,
        weakest=float(np.mean([c.weakest for c in told])) if known else None,
        measured=share_interval(by_world) if len(by_world) else None,
    )


def _of_same_worlds(cells: Sequence[HomogeneousCell]) -> list[list[HomogeneousCell]]:
    """Groups of cells with the same seeds of worlds and numbers of sequences and replicates."""
    groups: dict[tuple, list[HomogeneousCell]] = {}
    for cell in cells:
        groups.setdefault((cell.shape, tuple(cell.worlds)), []).append(cell)
    return list(groups.values())


def _within(
    group: list[HomogeneousCell], n: int, rng: np.random.Generator, permutations: int
) -> list[WithinSequences]:
    if group[0].shape[2] < 2:  # no repeats
        return []
    test = within_sequences([cell.outcomes.of_first(n) for cell in group], rng, permutations)
    ratio = test.statistic / test.expected if test.expected else None
    return [WithinSequences(n, len(group), test.telling or 0, ratio, test.p)]


def _formulas(group: list[HomogeneousCell], judged: Sequence[JudgedCell], n: int) -> list[Formulas]:
    each = [cell.outcomes.of_first(n) for cell in group]
    complete = np.all([outcomes.has_units for outcomes in each], axis=0)
    if complete.sum() < 3 or not sum(np.nansum(o.dual_failures[-1]) for o in each):
        return []
    each = [outcomes.of_worlds(complete) for outcomes in each]
    of = {(c.cell, c.world): c for c in judged if c.n == n}
    fitted = [
        (c := of[cell.name, cell.world]).verdict_in_units != Verdict.UNTESTED and not c.saturated
        for cell in group
    ]
    # Without a cell to fit them to, the factors are 0 and the formulas Eq. 1.
    told = [name for name in FORMULAS if any(fitted) or name not in ("beta factor", "one factor")]
    scores = (compare_formulas(each, fitted, on_units) for on_units in (False, True))
    on_dual_failures, on_units = (tuple(s for s in of_all if s.name in told) for of_all in scores)
    gain = Figure.mean(np.mean([second_thread_gain(o) for o in each], axis=0)) if n > 1 else None
    return [
        Formulas(
            n=n,
            cells=tuple((cell.name, cell.world) for cell in group),
            worlds=int(complete.sum()),
            on_dual_failures=on_dual_failures,
            on_units=on_units,
            second_thread=difference_interval(gain) if gain else None,
        )
    ]
