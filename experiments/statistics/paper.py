"""Reanalysis of the paper's Tables II and III with respect to Eq. 1.

Source: Huang et al., "Dual-SLAM: A framework for robust single camera navigation", IROS 2020,
    Tables I to III.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import beta, fisher_exact

from dslab.experiments.statistics.outcomes import Floats
from dslab.experiments.statistics.world_intervals import Interval
from dslab.scenarios.seeds import rng_for

TRIALS_PER_SEQUENCE = 10
_TAIL = (1 - 0.95) / 2


@dataclass(frozen=True)
class Proportion:
    """A share of independent units and its exact interval, never NaN.

    Attributes:
        estimate: the share; None without units.
        events, units: number of units with the property, and of all.
        low, high: ends of the interval of 95 %; [0, 1] without units.
    """

    estimate: float | None
    events: int
    units: int
    low: float
    high: float
    confidence: float = 0.95


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


def clopper_pearson(events: int, units: int) -> Proportion:
    """Exact interval, which covers any true share with at least 95 %.

    Source: Clopper & Pearson, "The use of confidence or fiducial limits", Biometrika 1934.
    """
    low = float(beta.ppf(_TAIL, events, units - events + 1)) if events > 0 else 0.0
    high = float(beta.isf(_TAIL, events + 1, units - events)) if events < units else 1.0
    return Proportion(events / units if units else None, events, units, low, high)


def reanalyse(draws: int = 20_000, seed: int = 0) -> tuple[PaperAnalysis, ...]:
    """Reanalyse every row of Table III, and the total of each system after its rows."""
    found = []
    for system in dict.fromkeys(row.system for row in TABLE_III):
        rows = [row for row in TABLE_III if row.system == system]
        numbers = ("trials", "breakages", "with_one", "with_two", "failures")
        total = PaperCounts(system, "Total", *(sum(getattr(r, name) for r in rows) for name in numbers))
        found += [_reanalyse(row, draws, seed) for row in (*rows, total)]
    return tuple(found)


def _reanalyse(counts: PaperCounts, draws: int, seed: int) -> PaperAnalysis:
    datasets = [counts.dataset] if counts.dataset in TABLE_II else list(TABLE_II)
    failures, trials = (sum(TABLE_II[d]["ORB-SLAM"][i] for d in datasets) for i in range(2))
    rng = rng_for(seed, "paper", counts.system, counts.dataset)

    def posterior(trials_as_one: int) -> tuple[Floats, Floats, Floats]:
        """Draws of p0 and of the threads' shares of failures under Jeffreys' prior."""
        pairs = (
            (counts.breakages, counts.trials - counts.breakages),
            (counts.first_failed, counts.with_one),
            (counts.failures, counts.with_two),
        )
        p0, first, second = (
            rng.beta(events / trials_as_one + 0.5, others / trials_as_one + 0.5, draws)
            for events, others in pairs
        )
        return p0, first, second

    p0, first, second = posterior(1)
    _, first_alike, second_alike = posterior(TRIALS_PER_SEQUENCE)
    share_1, share_2 = counts.first_failed / counts.breakages, counts.failures / counts.first_failed
    ratio = share_2 / share_1
    table = [[counts.first_failed, counts.with_one], [counts.failures, counts.with_two]]
    return PaperAnalysis(
        counts,
        clopper_pearson(failures, trials),
        clopper_pearson(counts.breakages, counts.trials),
        clopper_pearson(counts.first_failed, counts.breakages),
        clopper_pearson(counts.failures, counts.first_failed),
        clopper_pearson(counts.failures, counts.trials),
        _of_draws(counts.breakages / counts.trials * share_1**2, p0 * first**2),
        _of_draws(ratio, second / first),
        _of_draws(ratio, second_alike / first_alike),
        float(fisher_exact(table, "two-sided").pvalue),
    )


def _of_draws(value: float, draws: Floats) -> Interval:
    """A value with the equal-tailed interval of draws from the posterior."""
    low, high = np.quantile(draws, [_TAIL, 1 - _TAIL])
    return Interval(value, float(low), float(high))
