"""The analysis of one cell: its records in, its figures out."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from experiments.eq1.records import Outcome, dual_column, thread_column
from experiments.statistics import dependence
from experiments.statistics.clustering import cluster_bootstrap
from experiments.statistics.eq1 import predicted_and_ratio, predicted_at_free_length, verdict
from experiments.statistics.equivalence import tost
from experiments.statistics.intervals import Proportion, clopper_pearson, jeffreys
from experiments.statistics.joint import Bools, JointCounts
from experiments.statistics.likelihood_ratio import Eq1Test, eq1_test
from experiments.statistics.results import (
    AnalysisSettings,
    CellAnalysis,
    Estimate,
    LevelAnalysis,
    ThreadAnalysis,
)
from experiments.statistics.sequences import confidence_sequence
from scenarios.seeds import rng_for


@dataclass(frozen=True)
class CellData:
    """A cell's records, the columns typed.

    Attributes:
        name: of the cell.
        rows: all its records.
        completed: the records that enter the figures.
        threads: largest n.
    """

    name: str
    rows: pd.DataFrame
    completed: pd.DataFrame
    threads: int

    @classmethod
    def of_rows(cls, name: str, rows: pd.DataFrame, threads: int) -> "CellData":
        """Build from a cell's rows; units count if completed with a known B."""
        completed = rows.loc[(rows["outcome"] == Outcome.COMPLETED.value) & rows["breakage"].notna()]
        return cls(name, rows, completed, threads)

    def known(self, *columns: str) -> pd.DataFrame:
        """Completed units in which none of these columns is null."""
        return self.completed.loc[self.completed[list(columns)].notna().all(axis=1)]

    def joint(self, n: int) -> JointCounts:
        """Counts of the units that completed both arms, by outcome with the first n threads."""
        crossing = [thread_column("cross", j, "failed") for j in range(1, n + 1)]
        rows = self.known(*crossing)
        breakage, failure = flags(rows, "breakage"), rows[dual_column(n)]
        decided = ~breakage | failure.notna().to_numpy()
        failed = np.column_stack([flags(rows, c) for c in crossing])
        return JointCounts.of_units(
            breakage[decided], failure.fillna(False).to_numpy(bool)[decided], failed[decided]
        )


def flags(rows: pd.DataFrame, column: str) -> Bools:
    """A column without nulls, as booleans."""
    return rows[column].to_numpy(bool)


@dataclass(frozen=True)
class LevelTest:
    """Test of one cell at one n, before the correction over cells."""

    counts: JointCounts
    test: Eq1Test


def level_test(data: CellData, n: int, settings: AnalysisSettings) -> LevelTest:
    """The likelihood-ratio test of one cell at one n."""
    counts = data.joint(n)
    rng = rng_for(settings.seed, "likelihood ratio", data.name, n)
    return LevelTest(counts, eq1_test(counts, settings.replicates, rng, settings.power_ratio))


def analyse_cell(
    data: CellData,
    tests: list[LevelTest],
    corrected: list[float | None],
    tested_cells: list[int],
    settings: AnalysisSettings,
) -> CellAnalysis:
    """All figures of a cell.

    Args:
        data: of the cell.
        tests, corrected, tested_cells: per n from 1: the test, its p corrected over cells, and the number of
            cells tested.
        settings: of the analysis.
    """
    done, rows = data.completed, data.rows
    breakage = flags(done, "breakage")
    exact = partial(clopper_pearson, confidence=settings.confidence)
    broken = done[breakage]
    anytime = confidence_sequence(int(breakage.sum()), breakage.size, settings.confidence)
    outcome = rows["outcome"]
    return CellAnalysis(
        cell=data.name,
        kind=str(rows["kind"].iloc[0]),
        severity=_median(rows, "severity"),
        units=len(rows),
        completed=len(done),
        void=int((outcome == Outcome.VOID.value).sum()),
        errors=int((outcome == Outcome.INFRASTRUCTURE_ERROR.value).sum()),
        p0=exact(int(breakage.sum()), breakage.size),
        p0_jeffreys=jeffreys(int(breakage.sum()), breakage.size, settings.confidence),
        p0_anytime=Estimate(anytime.estimate, anytime.low, anytime.high, "beta-binomial confidence sequence"),
        p0_cluster=cluster_bootstrap(
            breakage,
            done["world_seed"].to_numpy(),
            settings.draws,
            rng_for(settings.seed, "worlds", data.name),
            settings.confidence,
        ),
        worlds=int(done["world_seed"].nunique()),
        base_failure=_share(done, "base_failure", exact),
        relocalized=_share(broken, "relocalized", exact),
        silent=_share(done, "silent_failure", exact),
        no_reinit=_share(broken, "reinit", exact, negated=True),
        cross_no_reinit=_share(done, "cross_reinit", exact, negated=True),
        threads=tuple(_thread(data, j, settings) for j in range(1, data.threads + 1)),
        rho_2_given_1=_second_given_first(data, settings) if data.threads > 1 else None,
        levels=tuple(
            _level(data, n, tests[n - 1], corrected[n - 1], tested_cells[n - 1], settings)
            for n in range(1, data.threads + 1)
        ),
        frames_to_cross_free=_median(broken, "free_frames_to_cross"),
        frames_to_cross_cross=_median(done, "cross_frames_to_cross"),
        declaration_delay_s=_median(broken, "declaration_delay_s"),
    )


def _level(
    data: CellData,
    n: int,
    found: LevelTest,
    corrected: float | None,
    tested_cells: int,
    settings: AnalysisSettings,
) -> LevelAnalysis:
    done, column = data.completed, dual_column(n)
    decided = done[~flags(done, "breakage") | done[column].notna().to_numpy()]
    failures = int((flags(decided, "breakage") & decided[column].fillna(False).to_numpy(bool)).sum())
    counts, test = found.counts, found.test
    rng = partial(rng_for, settings.seed)
    predicted, ratio = predicted_and_ratio(
        counts, settings.draws, rng("posterior", data.name, n), settings.confidence
    )
    # Holm's least favourable step: a lower bound of the verdict's power.
    power = test.power(settings.alpha / max(tested_cells, 1))
    margins = counts.margins
    units = float(margins.units[0])
    return LevelAnalysis(
        n=n,
        measured=clopper_pearson(failures, len(decided), settings.confidence),
        measured_jeffreys=jeffreys(failures, len(decided), settings.confidence),
        predicted=predicted,
        predicted_at_free_length=predicted_at_free_length(
            float(margins.breakages[0]) / units if units else None,
            [float(k) / units if units else None for k in margins.crossings[0]],
            _median(done[flags(done, "breakage")], "free_frames_to_cross"),
            _median(done, "cross_frames_to_cross"),
        ),
        ratio=ratio,
        lrt_statistic=test.statistic,
        lrt_p=test.p,
        holm_p=corrected,
        power_ratio_2=power,
        verdict=verdict(corrected, test.measured_above, power, settings.alpha, settings.power_wanted),
        tost_p=tost(
            counts, settings.equivalence_ratio, settings.replicates, rng("equivalence", data.name, n)
        ),
    )


def _thread(data: CellData, thread: int, settings: AnalysisSettings) -> ThreadAnalysis:
    def column(arm: str, name: str) -> str:
        return thread_column("cross" if arm == "cross" else "free", thread, name)

    exact = partial(clopper_pearson, confidence=settings.confidence)
    crossed = data.known(column("cross", "failed"))
    breakage, failed = flags(crossed, "breakage"), flags(crossed, column("cross", "failed"))
    paired = dependence.PairedCounts.of_units(breakage, failed)
    broken = data.completed[flags(data.completed, "breakage")]
    rng = partial(rng_for, settings.seed)
    odds, odds_p = dependence.mantel_haenszel(
        breakage, failed, crossed["world_seed"].to_numpy(), settings.confidence
    )
    methods = settings.thread_methods
    return ThreadAnalysis(
        thread=thread,
        method=methods[thread - 1] if thread <= len(methods) else None,
        pr=exact(int(failed.sum()), failed.size),
        pr_jeffreys=jeffreys(int(failed.sum()), failed.size, settings.confidence),
        pr_given_b=_share(broken, column("free", "failed"), exact),
        rho=dependence.conditional_ratio(
            paired, settings.draws, rng("rho", data.name, thread), settings.confidence
        ),
        phi=dependence.phi(paired, settings.draws, rng("phi", data.name, thread), settings.confidence),
        fisher_p=dependence.fisher(paired),
        mantel_haenszel=odds,
        mantel_haenszel_p=odds_p,
        mcnemar_p=dependence.mcnemar(paired),
        discordant=(paired.only_a, paired.only_r),
        false_recoveries=_false(data.completed, column("cross", "declared"), column("cross", "false"), exact),
        false_recoveries_given_b=_false(broken, column("free", "declared"), column("free", "false"), exact),
        stages=_stages(crossed, column("cross", "failed"), column("cross", "stage")),
        given_b_stages=_stages(broken, column("free", "failed"), column("free", "stage")),
    )


def _second_given_first(data: CellData, settings: AnalysisSettings) -> Estimate:
    """P(R_2 | B, R_1) / P(R_2)."""
    first, second = thread_column("cross", 1, "failed"), thread_column("cross", 2, "failed")
    rows = data.known(first, second)
    both = flags(rows, "breakage") & flags(rows, first)
    paired = dependence.PairedCounts.of_units(both, flags(rows, second))
    rng = rng_for(settings.seed, "rho", data.name, "2 given 1")
    return dependence.conditional_ratio(paired, settings.draws, rng, settings.confidence)


def _share(
    rows: pd.DataFrame, column: str, interval: Callable[[int, int], Proportion], negated: bool = False
) -> Proportion:
    values = rows[column].dropna().to_numpy(bool)
    return interval(int((~values if negated else values).sum()), values.size)


def _false(
    rows: pd.DataFrame, declared: str, false: str, interval: Callable[[int, int], Proportion]
) -> Proportion:
    recovered = rows[declared].fillna(False).to_numpy(bool)
    return _share(rows.loc[recovered, [false]], false, interval)


def _stages(rows: pd.DataFrame, failed: str, stage: str) -> dict[str, int]:
    names = rows.loc[rows[failed].fillna(False).to_numpy(bool), stage].fillna("unknown").astype(str)
    return {str(name): int(number) for name, number in names.value_counts().sort_index().items()}


def _median(rows: pd.DataFrame, column: str) -> float | None:
    values = rows[column].dropna()
    return float(values.median()) if len(values) else None
