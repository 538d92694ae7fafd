"""The whole analysis of an experiment's table of records: a pure function of the table."""

import numpy as np
import pandas as pd

from experiments.eq1.record_table import PANDAS_TYPES
from experiments.eq1.records import columns, thread_column
from experiments.statistics import clustering, heterogeneity
from experiments.statistics.cell import CellData, LevelTest, analyse_cell, flags, level_test
from experiments.statistics.conditioning import QUANTITIES, baseline_errors, lead_ins
from experiments.statistics.dose_response import dose_response
from experiments.statistics.equivalence import holm
from experiments.statistics.results import (
    Analysis,
    AnalysisSettings,
    BaselineErrors,
    BetaBinomial,
    CellAnalysis,
    DosePoint,
    DoseResponse,
    Estimate,
    Heterogeneity,
)
from scenarios.seeds import rng_for

_DEFAULT = AnalysisSettings()


def analyse(table: pd.DataFrame, threads: int, settings: AnalysisSettings = _DEFAULT) -> Analysis:
    """Analyse an experiment's records with respect to Eq. 1.

    Only completed units enter the figures; void units and infrastructure errors are counted separately.

    Args:
        table: one row per unit, columns as `experiments.eq1.records.columns`; missing ones count as unknown.
        threads: largest n.
        settings: fixed before the data are seen.

    Raises:
        ValueError: no recovery thread.
    """
    if threads < 1:
        raise ValueError(f"{threads} recovery threads: Eq. 1 needs at least one")
    table = _typed(table, threads)
    cells = [
        CellData.of_rows(str(name), rows, threads)
        for name, rows in table.groupby("cell", sort=False)
        if len(rows)
    ]
    levels = range(1, threads + 1)
    tests = [[level_test(data, n, settings) for n in levels] for data in cells]
    corrected = [holm([of_cell[n - 1].test.p for of_cell in tests]) for n in levels]
    tested = [sum(p is not None for p in of_level) for of_level in corrected]
    found = tuple(
        analyse_cell(data, tests[i], [of_level[i] for of_level in corrected], tested, settings)
        for i, data in enumerate(cells)
    )
    return Analysis(
        threads,
        found,
        _heterogeneity(cells, tests, threads, settings),
        _dose_responses(found, threads, settings),
        _notes(found, settings),
        settings,
        _conditioning(table, settings),
    )


def _typed(table: pd.DataFrame, threads: int) -> pd.DataFrame:
    """The records' columns in nullable types, in an order independent of which unit ended first."""
    wanted = columns(threads)
    table = table.reindex(columns=list(wanted))
    table = table.astype({name: PANDAS_TYPES[kind] for name, kind in wanted.items()})
    return table.sort_values(["kind", "severity", "cell", "index", "unit_id"], kind="stable")


def _heterogeneity(
    cells: list[CellData], tests: list[list[LevelTest]], threads: int, settings: AnalysisSettings
) -> Heterogeneity:
    levels = range(1, threads + 1)
    confidence = settings.confidence
    pooled = [
        heterogeneity.eckhardt_lee(
            [t[n - 1].counts for t in tests],
            settings.draws,
            rng_for(settings.seed, "eckhardt lee", n),
            confidence,
        )
        for n in levels
    ]
    common = [
        heterogeneity.beta_factor(
            {c.name: t[n - 1].counts for c, t in zip(cells, tests, strict=True)}, confidence
        )
        for n in levels
    ]
    return Heterogeneity(
        tuple(p for p in pooled if p is not None),
        _unevenness(cells, threads),
        tuple(c for c in common if c is not None),
        heterogeneity.mixture(
            _failed_threads(cells, threads),
            threads,
            settings.draws,
            rng_for(settings.seed, "mixture"),
            confidence,
        ),
        _gee(cells, threads, confidence),
    )


def _unevenness(cells: list[CellData], threads: int) -> tuple[BetaBinomial, ...]:
    """Uneven difficulty over cells, per quantity, and over units, for all their crossings."""
    named = {"p0 over cells": "breakage"}
    named |= {f"pr{j} over cells": thread_column("cross", j, "failed") for j in range(1, threads + 1)}
    found = []
    for quantity, column in named.items():
        values = [flags(c.known(column), column) for c in cells]
        events, units = np.array([v.sum() for v in values]), np.array([v.size for v in values])
        found.append(heterogeneity.beta_binomial(quantity, events, units))
    crossings = [c.known(*named.values())[list(named.values())].to_numpy(bool).sum(axis=1) for c in cells]
    events = np.concatenate(crossings) if crossings else np.zeros(0)
    found.append(
        heterogeneity.beta_binomial("crossings over units", events, np.full(events.size, 1.0 + threads))
    )
    return tuple(found)


def _failed_threads(cells: list[CellData], threads: int) -> list[int]:
    """Number of failed recoveries of each breakage in the free arm."""
    names = [thread_column("free", j, "failed") for j in range(1, threads + 1)]
    failed: list[int] = []
    for cell in cells:
        rows = cell.known(*names)
        failed += rows.loc[flags(rows, "breakage"), names].to_numpy(bool).sum(axis=1).tolist()
    return failed


def _gee(cells: list[CellData], threads: int, confidence: float) -> dict[str, Estimate]:
    """Shares over all units, and odds ratios within cells, robust to units sharing a world."""
    found: dict[str, Estimate] = {}
    frames = [c.completed for c in cells if len(c.completed)]
    if not frames:
        return found
    rows = pd.concat(frames)
    found["p0"] = clustering.gee_share(flags(rows, "breakage"), rows["world_seed"].to_numpy(), confidence)
    for j in range(1, threads + 1):
        column = thread_column("cross", j, "failed")
        crossed = rows[rows[column].notna()]
        breakage, failed = flags(crossed, "breakage"), flags(crossed, column)
        world, cell = crossed["world_seed"].to_numpy(), crossed["cell"].to_numpy()
        found[f"pr{j}"] = clustering.gee_share(failed, world, confidence)
        backward = np.repeat([False, True], len(crossed))
        found[f"odds of pr{j} to p0"] = clustering.gee_odds_ratio(
            np.concatenate([breakage, failed]), backward, np.tile(world, 2), np.tile(cell, 2), confidence
        )
        found[f"odds of R_{j} with to without B"] = clustering.gee_odds_ratio(
            failed, breakage, world, cell, confidence
        )
    return found


def _dose_responses(
    cells: tuple[CellAnalysis, ...], threads: int, settings: AnalysisSettings
) -> tuple[DoseResponse, ...]:
    found = []
    for kind in dict.fromkeys(c.kind for c in cells):
        dosed = sorted(
            (c for c in cells if c.kind == kind and c.severity is not None), key=lambda c: c.severity or 0.0
        )
        for thread in range(threads + 1):
            points = [
                DosePoint(c.severity or 0.0, c.threads[thread - 1].pr if thread else c.p0) for c in dosed
            ]
            quantity = f"pr{thread}" if thread else "p0"
            found.append(dose_response(kind, quantity, points, settings.confidence))
    return tuple(found)


def _conditioning(table: pd.DataFrame, settings: AnalysisSettings) -> tuple[BaselineErrors, ...]:
    rows = lead_ins(table)
    found = (
        baseline_errors(
            rows,
            quantity,
            settings.draws,
            rng_for(settings.seed, "conditioning", quantity),
            settings.confidence,
        )
        for quantity in QUANTITIES
    )
    return tuple(errors for errors in found if errors is not None)


def _notes(cells: tuple[CellAnalysis, ...], settings: AnalysisSettings) -> tuple[str, ...]:
    """Remarks needed to read the figures."""
    if not cells:
        return ("No unit has been recorded.",)
    notes = []
    void, errors = sum(c.void for c in cells), sum(c.errors for c in cells)
    if void or errors:
        notes.append(
            f"{void} void units (no healthy map at the onset) and {errors} infrastructure errors are in no"
            " figure."
        )
    empty = [c.cell for c in cells if c.completed == 0]
    if empty:
        notes.append(f"No completed unit in {', '.join(empty)}.")
    shared = [c.cell for c in cells if 0 < c.worlds < c.completed]
    if shared:
        notes.append(
            f"Units share worlds in {', '.join(shared)}: intervals and tests take units as independent and"
            " may be too sharp there; the cluster bootstrap and the GEE do not."
        )
    uncrossed = [c.cell for c in cells if c.completed and not any(t.pr.units for t in c.threads)]
    if uncrossed:
        notes.append(f"No crossing arm, hence no prediction, in {', '.join(uncrossed)}.")
    undecided = sum(level.verdict == "undecided" for c in cells for level in c.levels)
    if undecided:
        levels = sum(len(c.levels) for c in cells)
        notes.append(
            f"{undecided} of {levels} verdicts are undecided: Eq. 1 is not rejected, but a ratio of"
            f" {settings.power_ratio:g} would have been missed with a probability over"
            f" {1 - settings.power_wanted:.2g}, or nothing failed that could be tested. This is no support of"
            " it."
        )
    return tuple(notes)
