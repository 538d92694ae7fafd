"""Reanalysis of the paper's Tables II and III with respect to Eq. 1.

Source: Huang et al., "Dual-SLAM: A framework for robust single camera navigation", IROS 2020,
    Tables I to III.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import fisher_exact

from dslab.experiments.statistics.intervals import Proportion, clopper_pearson
from dslab.experiments.statistics.outcomes import Floats
from dslab.experiments.statistics.world_intervals import Interval
from dslab.scenarios.seeds import rng_for

TRIALS_PER_SEQUENCE = 10


@dataclass(frozen=True)
class PaperCounts:
    """Trials of one system on one data set, Table III.

    Attributes:
        system, dataset: as the paper names them.
        trials: number of trials.
        breakages: "Needs Recovery".
        with_one: recovered by the first thread.
        with_two: recovered by the second, after the first had failed.
        failures: recovered by neither.
    """

    system: str
    dataset: str
    trials: int
    breakages: int
    with_one: int
    with_two: int
    failures: int

    @property
    def first_failed(self) -> int:
        """Breakages after which the first thread failed; only on these did the second run."""
        return self.with_two + self.failures


TABLE_III: tuple[PaperCounts, ...] = (
    PaperCounts("Dual-SLAM", "KITTI", 110, 28, 17, 1, 10),
    PaperCounts("Dual-SLAM", "TUM-Mono", 500, 125, 106, 5, 14),
    PaperCounts("Dual-SLAM⁺", "KITTI", 110, 30, 22, 2, 6),
    PaperCounts("Dual-SLAM⁺", "TUM-Mono", 500, 126, 110, 4, 12),
)

TABLE_II: dict[str, dict[str, tuple[int, int]]] = {
    "KITTI": {"ORB-SLAM": (28, 110), "Dual-SLAM": (10, 110), "Dual-SLAM⁺": (6, 110)},
    "TUM-Mono": {"ORB-SLAM": (126, 500), "Dual-SLAM": (14, 500), "Dual-SLAM⁺": (12, 500)},
}
"""Data set, system: failures and trials."""

CAVEATS: tuple[str, ...] = (
    f"{TRIALS_PER_SEQUENCE} trials share a sequence, so that trials are not independent: the intervals are"
    " too narrow by an amount that the tables do not give. The ratio with ten trials as one takes the trials"
    " of a sequence for one: the other extreme.",
    "On KITTI, Dual-SLAM fails 10 times, and only on sequence 01 (Table I): the 10 trials of one sequence.",
    "Thread 2 ran only after thread 1 had failed. Its own failure probability cannot be had from the paper,"
    " nor can that of thread 1 apart from breakages: thread 1's share of failures stands for pr.",
    "The two threads use different methods (ORB tracking; SIFT and PnP). The paper expects the second to be"
    " the better one, in which case Eq. 1 would predict still fewer failures than stated here.",
    "Measured and predicted share p0 and the first thread's failures: their ratio is that of the second"
    " thread's share of failures to the first one's.",
)


@dataclass(frozen=True)
class PaperAnalysis:
    """Eq. 1 with n = 2 on one row of counts.

    Attributes:
        counts: as published; the data set "Total" is the sum.
        base_failure: ORB-SLAM's share of failures in Table II.
        p0: breakages of trials.
        thread_1: failures of breakages, which stands for pr.
        thread_2: failures of the breakages at which thread 1 had failed.
        measured: failures of trials.
        predicted: p0 · pr².
        ratio: measured over predicted.
        ratio_if_alike: the same if the trials of a sequence were one trial each: counts over ten.
        alike_p: exact test of "thread 2 fails as often as thread 1".
    """

    counts: PaperCounts
    base_failure: Proportion
    p0: Proportion
    thread_1: Proportion
    thread_2: Proportion
    measured: Proportion
    predicted: Interval
    ratio: Interval
    ratio_if_alike: Interval
    alike_p: float


def reanalyse(confidence: float = 0.95, draws: int = 20_000, seed: int = 0) -> tuple[PaperAnalysis, ...]:
    """Reanalyse every row of Table III, and the total of each system after its rows."""
    found = []
    for system in dict.fromkeys(row.system for row in TABLE_III):
        rows = [row for row in TABLE_III if row.system == system]
        found += [reanalyse_row(row, confidence, draws, seed) for row in (*rows, total(rows))]
    return tuple(found)


def total(rows: list[PaperCounts]) -> PaperCounts:
    """The sum of a system's rows."""
    return PaperCounts(
        rows[0].system,
        "Total",
        sum(r.trials for r in rows),
        sum(r.breakages for r in rows),
        sum(r.with_one for r in rows),
        sum(r.with_two for r in rows),
        sum(r.failures for r in rows),
    )


def reanalyse_row(counts: PaperCounts, confidence: float, draws: int, seed: int) -> PaperAnalysis:
    """Reanalyse one row."""
    datasets = [counts.dataset] if counts.dataset in TABLE_II else list(TABLE_II)
    failures, trials = (sum(TABLE_II[d]["ORB-SLAM"][i] for d in datasets) for i in range(2))
    rng = rng_for(seed, "paper", counts.system, counts.dataset)
    p0, first, second = _posterior(counts, 1, draws, rng)
    _, first_alike, second_alike = _posterior(counts, TRIALS_PER_SEQUENCE, draws, rng)
    share_1, share_2 = counts.first_failed / counts.breakages, counts.failures / counts.first_failed
    ratio = share_2 / share_1
    return PaperAnalysis(
        counts,
        clopper_pearson(failures, trials, confidence),
        clopper_pearson(counts.breakages, counts.trials, confidence),
        clopper_pearson(counts.first_failed, counts.breakages, confidence),
        clopper_pearson(counts.failures, counts.first_failed, confidence),
        clopper_pearson(counts.failures, counts.trials, confidence),
        _of_draws(counts.breakages / counts.trials * share_1**2, p0 * first**2, confidence),
        _of_draws(ratio, second / first, confidence),
        _of_draws(ratio, second_alike / first_alike, confidence),
        float(
            fisher_exact(
                [[counts.first_failed, counts.with_one], [counts.failures, counts.with_two]], "two-sided"
            ).pvalue
        ),
    )


def _posterior(
    counts: PaperCounts, trials_as_one: int, draws: int, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    def share(events: int, others: int) -> Floats:
        return rng.beta(events / trials_as_one + 0.5, others / trials_as_one + 0.5, draws)

    return (
        share(counts.breakages, counts.trials - counts.breakages),
        share(counts.first_failed, counts.with_one),
        share(counts.failures, counts.with_two),
    )


def _of_draws(value: float, draws: Floats, confidence: float) -> Interval:
    """A value with the equal-tailed interval of draws from the posterior under Jeffreys' prior."""
    low, high = np.quantile(draws, [(1 - confidence) / 2, (1 + confidence) / 2])
    return Interval(value, float(low), float(high))
