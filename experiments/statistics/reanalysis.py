"""Eq. 1 anew from a table of records: what its units say once cells and worlds are kept apart."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd

from experiments.statistics.estimates import chain, correlation_in_sequences
from experiments.statistics.from_records import HomogeneousCell, cells_of
from experiments.statistics.outcomes import Floats, Outcomes, world_means
from experiments.statistics.permutations import independence, permutations_for
from experiments.statistics.products import product_of_distinct
from experiments.statistics.verdicts import Comparison, Verdict, compare_forecast, compare_units, verdicts
from experiments.statistics.world_intervals import (
    Interval,
    Rare,
    few_events,
    ratio_interval,
    share_interval,
)


@dataclass(frozen=True)
class Level:
    """Figures over all cells with n recovery threads, cells weighted by their units.

    Attributes:
        n: number of threads.
        within_kinds: product over distinct units of a cell and kind of world: Eq. 1.
        within_worlds: product over distinct units of a world; None where a world has too few.
        in_units: Q, the factors at once in one unit of the crossing arm.
        measured: D, dual failures of the free arm.
        by_worlds: mean over worlds of the dual failures, with its interval.
    """

    n: int
    within_kinds: float
    within_worlds: float | None
    in_units: float
    measured: float
    by_worlds: Interval


@dataclass(frozen=True)
class CellAtLevel:
    """One cell in one kind of world, with n recovery threads.

    Attributes:
        cell, world: its names.
        n: number of threads.
        worlds_with: worlds with a breakage, and with a failure of each thread.
        units, forecast: Q and D against Eq. 1.
        independence, prediction: the verdicts on them.
        steps: from Eq. 1 to what is measured, as ratios by name: ``arms``, ``run``, ``path``, ``world`` or
            ``sequence``, ``whole``; only those that the design can tell and whose denominator is not 0.
        chance: share of B's variance that is chance and not the sequence, 1 - ICC; None without repeats.
        shares: by name ``breakage``, ``dual_failure`` (D_J), ``system_failure`` (S_J), ``mission_failure``
            (M_J), ``base_mission_failure`` and, of unbroken units, ``silent_failure``; those in the records.
    """

    cell: str
    world: str
    n: int
    worlds_with: tuple[int, ...]
    units: Comparison
    forecast: Comparison
    independence: Verdict
    prediction: Verdict
    steps: dict[str, Interval]
    chance: Interval | None
    shares: dict[str, Interval]


@dataclass(frozen=True)
class Reanalysis:
    """A table of records, analysed anew.

    Attributes:
        worlds, units, void: their numbers.
        levels: per n, over all cells.
        failed_or_silent: share of the units with a dual failure of all threads or a silent failure.
        cells: per cell, kind of world and n.
    """

    worlds: int
    units: int
    void: int
    levels: tuple[Level, ...]
    failed_or_silent: float
    cells: tuple[CellAtLevel, ...]

    def row(self) -> dict[str, Any]:
        """As numbers and texts, without what the estimates would be without each world."""
        cells = [
            {
                "cell": c.cell,
                "world": c.world,
                "n": c.n,
                "worlds_with": c.worlds_with,
                "eq1": c.units.product.value,
                "weakest_link": c.units.weakest.value,
                "in_units": c.units.measured.value,
                "measured": c.forecast.measured.value,
                "saturated": c.units.saturated,
                "p_independence": c.units.p,
                "p_forecast": c.forecast.p,
                "verdict_in_units": c.independence,
                "verdict_forecast": c.prediction,
                "way_to_weakest_in_units": c.units.way_to_weakest,
                "way_to_weakest_forecast": c.forecast.way_to_weakest,
                "steps": {name: asdict(ratio) for name, ratio in c.steps.items()},
                "chance": None if c.chance is None else asdict(c.chance),
                "shares": {name: asdict(share) for name, share in c.shares.items()},
            }
            for c in self.cells
        ]
        return {**asdict(self), "cells": cells}


def reanalyse(
    table: pd.DataFrame, threads: int, seed: int = 0, permutations: int | None = None
) -> Reanalysis:
    """Analyse a table of records by kind of world, with worlds as the sample.

    Args:
        table: records, with the columns of ``records.columns``; no cell need be homogeneous.
        threads: number of recovery threads.
        seed: of the permutations.
        permutations: their number; None for as many as the number of tests takes.

    Raises:
        ValueError: no unit was completed.
    """
    cells = cells_of(table, threads)
    units = sum(cell.units for cell in cells)
    if units == 0:
        raise ValueError("no completed unit")
    failed = sum(float(np.nansum(np.maximum(cell.outcomes.dual_failures[-1], cell.silent))) for cell in cells)
    return Reanalysis(
        worlds=len(np.unique(np.concatenate([cell.worlds for cell in cells]))),
        units=units,
        void=sum(cell.void for cell in cells),
        levels=tuple(_level(cells, n, units) for n in range(1, threads + 1)),
        failed_or_silent=failed / units,
        cells=_judged(cells, threads, np.random.default_rng(seed), permutations),
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
        by_worlds=share_interval(_by_world(cells, [o.dual_failures[-1] for o in each])),
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
    return total / count


def _by_world(cells: Sequence[HomogeneousCell], outcomes: Sequence[Floats]) -> Floats:
    """(W,) mean over all units of each world, in whatever cells they are."""
    seeds = np.unique(np.concatenate([cell.worlds for cell in cells]))
    sums, counts = np.zeros(len(seeds)), np.zeros(len(seeds))
    for cell, outcome in zip(cells, outcomes, strict=True):
        at = np.searchsorted(seeds, cell.worlds)
        sums[at] += np.nansum(outcome, axis=(1, 2))
        counts[at] += np.isfinite(outcome).sum(axis=(1, 2))
    return sums[counts > 0] / counts[counts > 0]


def _judged(
    cells: Sequence[HomogeneousCell], threads: int, rng: np.random.Generator, permutations: int | None
) -> tuple[CellAtLevel, ...]:
    """Verdicts on all cells, kinds of world and n, by Holm's correction over all of them."""
    number = permutations or permutations_for(len(cells) * threads)
    tested = []
    for n in range(1, threads + 1):
        for cell in cells:
            outcomes = cell.outcomes.of_first(n)
            outcomes = outcomes.of_worlds(outcomes.has_units)
            if len(outcomes.breakage) > 1 + n:
                test = independence(outcomes, rng, number)
                pair = compare_units(outcomes, test), compare_forecast(outcomes)
                happened = (outcomes.columns > 0).any(axis=(2, 3)).sum(axis=1)
                tested.append((cell, outcomes, tuple(map(int, happened)), *pair))
    found = verdicts([units for *_, units, _ in tested], [forecast for *_, forecast in tested])
    return tuple(
        CellAtLevel(
            cell.name,
            cell.world,
            outcomes.threads,
            happened,
            units,
            forecast,
            *verdict,
            _steps(outcomes),
            _chance(outcomes),
            _shares(cell, outcomes),
        )
        for (cell, outcomes, happened, units, forecast), *verdict in zip(tested, *found, strict=True)
    )


def _steps(outcomes: Outcomes) -> dict[str, Interval]:
    """The steps of the chain with their intervals."""
    found = chain(outcomes)
    margins = tuple(float(p) for p in world_means(outcomes.columns).mean(axis=1))
    ratios = {}
    for name in ("arms", "run", "path", "world", "sequence", "whole"):
        pair = getattr(found, name)
        if pair is None:
            continue
        # Only a product of margins has the variance of a product of counts.
        shares = margins if name in ("world", "sequence", "whole") else ()
        rare = Rare(shares) if few_events(pair[0].pseudo_values, shares) else None
        ratio = ratio_interval(*pair, rare)
        if ratio is not None:  # of shares, so never below 0
            ratios[name] = Interval(ratio.value, max(0.0, ratio.low), ratio.high)
    return ratios


def _chance(outcomes: Outcomes) -> Interval | None:
    correlation = correlation_in_sequences(outcomes.breakage)
    if correlation is None:
        return None
    within, variance = correlation
    return ratio_interval(variance - within, variance)


def _shares(cell: HomogeneousCell, outcomes: Outcomes) -> dict[str, Interval]:
    """Shares of units by world, over the units that every figure at this n uses."""
    n, valid = outcomes.threads, np.isfinite(cell.outcomes.of_first(outcomes.threads).breakage)
    events: dict[str, Floats | None] = {
        "breakage": cell.outcomes.breakage,
        "dual_failure": cell.outcomes.dual_failures[n - 1],
        "system_failure": None if cell.system_failures is None else cell.system_failures[n - 1],
        "mission_failure": None if cell.mission_failures is None else cell.mission_failures[n - 1],
        "base_mission_failure": cell.base_missions,
        "silent_failure": np.where(cell.outcomes.breakage == 0, cell.silent, np.nan),
    }
    shares = {}
    for name, event in events.items():
        if event is None:
            continue
        means = world_means(np.where(valid, event, np.nan))
        if np.isfinite(means).any():
            shares[name] = share_interval(means[np.isfinite(means)])
    return shares
