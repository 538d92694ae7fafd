"""The whole analysis of an experiment's records: a pure function of the table."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from dslab.experiments.eq1.records import thread_column
from dslab.experiments.statistics.by_conditions import (
    DosePoint,
    Part,
    delay_parts,
    dose_points,
    rescuable_parts,
)
from dslab.experiments.statistics.conditional import EventPair, Repeats, event_pairs, repeats
from dslab.experiments.statistics.conditioning import QUANTITIES, BaselineErrors, baseline_errors, lead_ins
from dslab.experiments.statistics.direction import Direction, directions
from dslab.experiments.statistics.from_records import cells_of
from dslab.experiments.statistics.judged import JudgedCell, judge_cells, share_of_chance
from dslab.experiments.statistics.permutations import permutations_for
from dslab.experiments.statistics.pooled import (
    Formulas,
    KindOfWorld,
    Level,
    WithinSequences,
    by_world,
    kind_of_world,
    level,
    permuted_within,
    score_formulas,
)
from dslab.experiments.statistics.readings import Readings, Rescuable, both_readings, rescuable_readings
from dslab.experiments.statistics.threads import ThreadPair, ThreadShares, thread_pairs, thread_shares
from dslab.experiments.statistics.world_intervals import Interval, share_interval


@dataclass(frozen=True)
class Analysis:
    """Eq. 1 by an experiment's records; a part that the design does not allow is empty or None.

    Without the free arm no breakage is known, and of what follows only the threads, doses and pose errors are
    told.

    Attributes:
        threads, worlds, units, void: their numbers; units are those whose stress acted.
        unexposed: number of units whose stress did not act: they are in no other figure.
        levels: per n, over all cells.
        failed_or_silent: share of the units with a dual failure of all threads or a silent failure.
        failed_or_silent_by_worlds: the same, worlds weighted alike.
        kinds_of_world: per kind of world and n.
        chance: by kind of world, 1 - ICC of B.
        cells: per n, cell and kind of world.
        readings: per n, over all cells and in each: Eq. 1 of each sequence and of averages.
        within_sequences: per n.
        event_pairs: B and the threads' failures within sequences, and across their runs.
        repeats: per cell and thread, sequences by their runs with both events.
        formulas: per n.
        sham: cells without a degradation, with all threads.
        without_stress: likewise of each cell the units whose stress did not act.
        thread_shares, thread_pairs: the threads beside each other, in the crossing arm.
        rescuable, delays: parts of the breakages.
        over_rescuable: per n and cell, Eq. 1 over rescuable units alone.
        doses: shares against dose.
        directions: pr against p0, for the threads of Algorithm 1.
        conditioning: pose error against baseline, for each quantity that was measured.
    """

    threads: int
    worlds: int
    units: int
    void: int
    unexposed: int
    levels: tuple[Level, ...]
    failed_or_silent: float | None
    failed_or_silent_by_worlds: Interval | None
    kinds_of_world: tuple[KindOfWorld, ...]
    chance: dict[str, Interval]
    cells: tuple[JudgedCell, ...]
    readings: tuple[Readings, ...]
    within_sequences: tuple[WithinSequences, ...]
    event_pairs: tuple[EventPair, ...]
    repeats: tuple[Repeats, ...]
    formulas: tuple[Formulas, ...]
    sham: tuple[JudgedCell, ...]
    without_stress: tuple[JudgedCell, ...]
    thread_shares: tuple[ThreadShares, ...]
    thread_pairs: tuple[ThreadPair, ...]
    rescuable: tuple[Part, ...]
    over_rescuable: tuple[Rescuable, ...]
    delays: tuple[Part, ...]
    doses: tuple[DosePoint, ...]
    directions: tuple[Direction, ...]
    conditioning: tuple[BaselineErrors, ...]


def analyse(
    table: pd.DataFrame,
    threads: int,
    confirmatory: Sequence[str] = (),
    paper_threads: Sequence[int] = (),
    seed: int = 0,
    permutations: int | None = None,
    confirmatory_threads: int | None = None,
) -> Analysis:
    """Analyse a table of records by kind of world, with worlds as the sample.

    Args:
        table: records, with the columns of ``records.columns``; no cell need be homogeneous.
        threads: number of recovery threads.
        confirmatory: cells named before the run.
        paper_threads: numbers of the threads of Algorithm 1, the first of each kind, if there are any.
        seed: of the permutations.
        permutations: their number; None for as many as the number of tests takes.
        confirmatory_threads: the first 1 to this many threads are tested there; None for all.

    Raises:
        ValueError: no recovery thread.
    """
    if threads < 1:
        raise ValueError(f"{threads} recovery threads: Eq. 1 needs at least one")
    cells = [cell for cell in cells_of(table, threads) if cell.units]
    shams = [cell for cell in cells_of(table, threads, sham=True) if cell.units]
    idle = [cell for cell in cells_of(table, threads, exposed=False) if cell.units]
    free_shams, free_idle = ([c for c in each if c.says("breakage")] for each in (shams, idle))
    rng, numbers = np.random.default_rng(seed), range(1, threads + 1)
    free = [cell for cell in cells if cell.says("breakage")]
    both_arms = [cell for cell in free if cell.says(thread_column("cross", 1, "failed"))]
    units = sum(cell.units for cell in free)
    judged = judge_cells(free, threads, confirmatory, rng, permutations, confirmatory_threads)
    named = [cell for cell in free if cell.name in confirmatory] or free
    failed = [np.maximum(c.outcomes.dual_failures[-1], c.events("silent_failure")) for c in free]
    kinds = list(dict.fromkeys(cell.world for cell in free))
    chance = {world: share_of_chance([c for c in free if c.world == world]) for world in kinds}
    tests = permutations or permutations_for(threads)
    return Analysis(
        threads=threads,
        worlds=len({(cell.world, seed) for cell in cells for seed in cell.worlds}),
        units=sum(cell.units for cell in cells),
        void=sum(cell.void for cell in cells),
        unexposed=sum(cell.units for cell in idle),
        levels=tuple(found for n in numbers if (found := level(free, n)) is not None),
        failed_or_silent=sum(float(np.nansum(f)) for f in failed) / units if units else None,
        failed_or_silent_by_worlds=share_interval(by_world(free, failed)) if units else None,
        kinds_of_world=tuple(kind_of_world(free, judged, world, n) for world in kinds for n in numbers),
        chance={world: share for world, share in chance.items() if share is not None},
        cells=judged,
        readings=tuple(found for n in numbers for found in both_readings(both_arms, n)),
        within_sequences=tuple(test for n in numbers for test in permuted_within(named, n, rng, tests)),
        event_pairs=event_pairs(both_arms),
        repeats=repeats(both_arms),
        formulas=tuple(found for n in numbers for found in score_formulas(free, judged, n)),
        sham=tuple(cell for cell in judge_cells(free_shams, threads, (), rng, 19) if cell.n == threads),
        without_stress=tuple(c for c in judge_cells(free_idle, threads, (), rng, 19) if c.n == threads),
        thread_shares=thread_shares(cells),
        thread_pairs=thread_pairs(cells),
        rescuable=rescuable_parts(free),
        over_rescuable=tuple(found for n in numbers for found in rescuable_readings(both_arms, n)),
        delays=delay_parts(free),
        doses=dose_points(cells, shams, threads),
        directions=directions(free, paper_threads),
        conditioning=tuple(filter(None, (baseline_errors(lead_ins(table), q) for q in QUANTITIES))),
    )
