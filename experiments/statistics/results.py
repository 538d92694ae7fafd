"""Results of the analysis of an experiment; None stands for "not determined"."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from experiments.statistics.intervals import Proportion

Verdict = Literal["consistent", "optimistic", "pessimistic", "undecided"]


@dataclass(frozen=True)
class AnalysisSettings:
    """Free choices of the analysis, fixed before the data are seen.

    Attributes:
        confidence: of every interval.
        alpha: size of every test, and of the family of tests that Holm's correction covers.
        power_ratio: ratio of measured to predicted that a cell must be able to detect, else it is undecided.
        power_wanted: least probability of detecting it.
        equivalence_ratio: Eq. 1 "holds" in the equivalence test within this factor, up or down.
        draws: from posteriors, and of the cluster bootstrap.
        replicates: of the parametric bootstrap.
        seed: of all of these.
        thread_methods: names of the recovery threads' kinds, in order, if known.
    """

    confidence: float = 0.95
    alpha: float = 0.05
    power_ratio: float = 2.0
    power_wanted: float = 0.8
    equivalence_ratio: float = 2.0
    draws: int = 4000
    replicates: int = 3999
    seed: int = 0
    thread_methods: tuple[str, ...] = ()


@dataclass(frozen=True)
class Estimate:
    """A number and its interval.

    Attributes:
        value: None if it is not defined (such as a ratio to zero).
        low, high: ends of the interval; None if the data set no bound on that side.
        method: description of the estimator.
    """

    value: float | None
    low: float | None
    high: float | None
    method: str

    @classmethod
    def undetermined(cls, method: str) -> "Estimate":
        """An estimate without value or bounds."""
        return cls(None, None, None, method)

    @classmethod
    def of_draws(cls, value: float, draws: np.ndarray, confidence: float, method: str) -> "Estimate":
        """A value with the equal-tailed interval of posterior draws."""
        low, high = np.quantile(draws, [(1 - confidence) / 2, (1 + confidence) / 2])
        return cls(value, float(low), float(high), method)


@dataclass(frozen=True)
class LevelAnalysis:
    """Eq. 1 in one cell with the first n recovery threads.

    Attributes:
        n: number of recovery threads.
        measured, measured_jeffreys: share of units with D_n, free arm.
        predicted: p0 times the product of pr_j, the crossing arm's.
        predicted_at_free_length: the same if each thread had only the free arm's median number of frames to
            cross, at a constant hazard per frame: the effect of the shorter way alone.
        ratio: measured over predicted.
        lrt_statistic, lrt_p: test of "Eq. 1 holds"; None if the counts are not informative.
        holm_p: corrected over the cells, for this n.
        power_ratio_2: probability that this cell, with its number of units, rejects Eq. 1 at a ratio of 2 (or
            `AnalysisSettings.power_ratio`), at the corrected level.
        verdict: consistent, optimistic (measured > predicted), pessimistic or undecided.
        tost_p: of the equivalence test; small if the ratio is within the equivalence bounds.
    """

    n: int
    measured: Proportion
    measured_jeffreys: Proportion
    predicted: Estimate
    predicted_at_free_length: float | None
    ratio: Estimate
    lrt_statistic: float | None
    lrt_p: float | None
    holm_p: float | None
    power_ratio_2: float | None
    verdict: Verdict
    tost_p: float | None


@dataclass(frozen=True)
class ThreadAnalysis:
    """One recovery thread in one cell.

    Attributes:
        thread: its number, from 1.
        method: its kind, where known.
        pr, pr_jeffreys: share of crossings of the whole segment that failed, of all completed units.
        pr_given_b: share of its recoveries in the free arm that failed, of the units with a breakage.
        rho: P(R_j | B) / P(R_j), both of the crossing arm; 1 under independence.
        phi: correlation of B and R_j.
        fisher_p: exact test of independence of B and R_j over all units.
        mantel_haenszel, mantel_haenszel_p: odds ratio and test within worlds; None if no world has units that
            differ.
        mcnemar_p: exact test of pr = p0 on paired units; Eq. 1's text claims this for the base's own method.
            The ORB thread is that method, except that it skips poor frames for up to two seconds.
        discordant: units with B but not R_j, and with R_j but not B.
        false_recoveries, false_recoveries_given_b: share of declared recoveries that the audit refutes,
            crossing arm and free arm.
        stages, given_b_stages: failures by stage, crossing arm and free arm.
    """

    thread: int
    method: str | None
    pr: Proportion
    pr_jeffreys: Proportion
    pr_given_b: Proportion
    rho: Estimate
    phi: Estimate
    fisher_p: float | None
    mantel_haenszel: Estimate
    mantel_haenszel_p: float | None
    mcnemar_p: float | None
    discordant: tuple[int, int]
    false_recoveries: Proportion
    false_recoveries_given_b: Proportion
    stages: Mapping[str, int]
    given_b_stages: Mapping[str, int]


@dataclass(frozen=True)
class CellAnalysis:
    """One cell.

    Attributes:
        cell, kind, severity: as in the table.
        units: rows of the table; completed + void + errors.
        p0, p0_jeffreys: share of completed units with B.
        p0_anytime: a confidence sequence, valid under repeated looks.
        p0_cluster: p0 with worlds, not units, resampled.
        worlds: number of worlds among the completed units.
        base_failure: share of completed units in which the base ends without an intact map.
        relocalized: given B.
        silent: share of completed units with a silent failure.
        no_reinit: given B, free arm; cross_no_reinit: of all completed, crossing arm.
        threads: per recovery thread.
        rho_2_given_1: P(R_2 | B, R_1) / P(R_2), crossing arm; None with fewer than two threads.
        levels: per n of Eq. 1.
        frames_to_cross_free, frames_to_cross_cross: medians.
        declaration_delay_s: median time from true loss to its declaration.
    """

    cell: str
    kind: str
    severity: float | None
    units: int
    completed: int
    void: int
    errors: int
    p0: Proportion
    p0_jeffreys: Proportion
    p0_anytime: Estimate
    p0_cluster: Estimate
    worlds: int
    base_failure: Proportion
    relocalized: Proportion
    silent: Proportion
    no_reinit: Proportion
    cross_no_reinit: Proportion
    threads: tuple[ThreadAnalysis, ...]
    rho_2_given_1: Estimate | None
    levels: tuple[LevelAnalysis, ...]
    frames_to_cross_free: float | None
    frames_to_cross_cross: float | None
    declaration_delay_s: float | None


@dataclass(frozen=True)
class EckhardtLee:
    """Eq. 1 pooled over cells in two ways, cells weighted by their completed units.

    Attributes:
        n: number of recovery threads.
        within: E[p0 · Π pr_j]: Eq. 1 applied in each cell, then averaged.
        pooled: E[p0] · Π E[pr_j]: averaged first, as in a benchmark over many sequences.
        measured: share of all completed units with D_n.
    """

    n: int
    within: Estimate
    pooled: Estimate
    measured: Proportion


@dataclass(frozen=True)
class BetaBinomial:
    """Uneven difficulty θ ~ Beta(alpha, beta), fitted by maximum likelihood.

    Attributes:
        quantity: name of the count.
        alpha, beta: None if the counts show no unevenness (θ is one number) or are not informative.
        mean: of θ.
        var_over_mean2: Var(θ) / E[θ]², the relative excess of coincident failures over E[θ]²; 0 without
            unevenness.
        p: of the likelihood-ratio test of "no unevenness" (boundary: half a chi-squared).
    """

    quantity: str
    alpha: float | None
    beta: float | None
    mean: float | None
    var_over_mean2: float | None
    p: float | None


@dataclass(frozen=True)
class BetaFactor:
    """Common-cause model: P(D_n) = β·min(p0, pr_j) + (1 − β)ⁿ⁺¹·p0·Π pr_j, one β for all cells.

    With n = 1 and pr = p0 it is P = βp + (1 − β)²p².
    """

    n: int
    beta: Estimate
    predicted: Mapping[str, float]
    """P(D_n) per cell at the fitted β."""


@dataclass(frozen=True)
class Mixture:
    """Two classes of breakages: hopeless ones, and the rest, in which threads fail independently.

    Attributes:
        breakages: number of breakages fitted.
        share_hopeless: share in which every thread fails.
        pr_rest: failure probability of each thread in the rest.
    """

    breakages: int
    share_hopeless: Estimate
    pr_rest: Estimate


@dataclass(frozen=True)
class Heterogeneity:
    """Uneven difficulty across cells.

    Attributes:
        eckhardt_lee: per n.
        beta_binomial: of B and of each R_j over cells, and of all crossings of a unit over units.
        beta_factor: per n.
        mixture: of the free arm's breakages; None with fewer than two threads or no breakage.
        gee: by name: p0 and pr_j averaged over all units, and odds ratios of pr_j to p0 and of R_j to B,
            with errors robust to units sharing a world.
    """

    eckhardt_lee: tuple[EckhardtLee, ...]
    beta_binomial: tuple[BetaBinomial, ...]
    beta_factor: tuple[BetaFactor, ...]
    mixture: Mixture | None
    gee: Mapping[str, Estimate]


@dataclass(frozen=True)
class DosePoint:
    """Share of failures at one severity."""

    severity: float
    proportion: Proportion


@dataclass(frozen=True)
class DoseResponse:
    """A failure probability against severity: logit p = intercept + slope · severity.

    Attributes:
        kind: of degradation.
        quantity: "p0", "pr1", "pr2" and so on.
        points: as measured.
        slope, intercept: None with fewer than two severities.
        curve: (severity, p, low, high) over the range of severities; empty without a fit.
        ed50: severity of 50% failures; bounds are None if the sign of the slope is not known.
    """

    kind: str
    quantity: str
    points: tuple[DosePoint, ...]
    slope: Estimate
    intercept: Estimate
    curve: tuple[tuple[float, float, float, float], ...]
    ed50: Estimate


@dataclass(frozen=True)
class GapErrors:
    """An error of the relative pose of two frames at one gap.

    Attributes:
        gap: in frames.
        lead_ins: number of lead-ins with such a pair.
        pairs: number of pairs in all of them.
        matches, baseline_m: medians over lead-ins.
        error: median over the lead-ins, in the unit of the quantity.
    """

    gap: int
    lead_ins: int
    pairs: int
    matches: float
    baseline_m: float
    error: Estimate


@dataclass(frozen=True)
class GapSlope:
    """Slope of log error on log baseline between two neighbouring gaps."""

    narrow: int
    wide: int
    slope: Estimate


@dataclass(frozen=True)
class BaselineErrors:
    """An error of the relative pose of two frames against their true baseline.

    Attributes:
        quantity: ``rotation_deg`` or ``direction_deg``.
        lead_ins, worlds: sample of the slope over all gaps: those with a pose at two gaps or more.
        gaps: medians, the narrowest first.
        slope: of log error on log baseline, within lead-ins, over all gaps: -1 if the error halves as the
            baseline doubles.
        steps: the same between neighbouring gaps.
    """

    quantity: str
    lead_ins: int
    worlds: int
    gaps: tuple[GapErrors, ...]
    slope: Estimate
    steps: tuple[GapSlope, ...]


@dataclass(frozen=True)
class Analysis:
    """The whole analysis of an experiment.

    Attributes:
        threads: largest n.
        cells: by kind, severity and name.
        heterogeneity: across cells.
        dose_response: per kind and quantity.
        notes: remarks needed to read the figures.
        settings: as used.
        conditioning: pose error against baseline, per quantity; empty if not measured.
    """

    threads: int
    cells: tuple[CellAnalysis, ...]
    heterogeneity: Heterogeneity
    dose_response: tuple[DoseResponse, ...]
    notes: tuple[str, ...] = ()
    settings: AnalysisSettings = field(default_factory=AnalysisSettings)
    conditioning: tuple[BaselineErrors, ...] = ()
