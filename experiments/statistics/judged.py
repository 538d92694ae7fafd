"""Cells of an experiment judged against Eq. 1: figures by worlds, the chain, the verdicts."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from dslab.experiments.eq1.records import failure_column
from dslab.experiments.statistics.estimates import (
    Figure,
    chain,
    correlation_in_sequences,
    measured_in_units,
    over_cells,
)
from dslab.experiments.statistics.from_records import HomogeneousCell
from dslab.experiments.statistics.outcomes import Floats, Outcomes, world_means
from dslab.experiments.statistics.permutations import independence, permutations_for
from dslab.experiments.statistics.verdicts import (
    Comparison,
    Verdict,
    compare_forecast,
    compare_units,
    corrected,
    verdicts,
)
from dslab.experiments.statistics.world_intervals import (
    Interval,
    few_events,
    ratio_interval,
    share_interval,
    way_interval,
)


@dataclass(frozen=True)
class JudgedCell:
    """One cell in one kind of world, with the first n recovery threads.

    Attributes:
        cell, world, kind, severity: its name, kind of world, kind of degradation and dose in the records.
        n: number of threads.
        confirmatory: whether it was named before the run.
        worlds, units: their numbers, of those that all figures at this n use.
        worlds_with: worlds with a breakage, and with a failure of each thread.
        eq1, weakest: pi_marg and the smallest of p0 and the threads' pr; None with too few worlds.
        in_units: Q.
        saturated: whether no formula can be told from another here.
        p_independence, p_forecast: of the tests of Q, the primary one, and D, by Holm; None with too few
            worlds, of D also with too few that have it.
        verdict_in_units, verdict_forecast: on Q and D.
        way_in_units, way_forecast: k of Q and D: 0 is Eq. 1, 1 the weakest link.
        steps: ratios by the names of ``estimates.chain``; only those that the design can tell and whose
            denominator is not 0.
        shares: by name ``breakage``, ``dual_failure`` (D_J), ``system_failure`` (S_J), ``mission_failure``
            (M_J), ``base_mission_failure`` and, of unbroken units, ``silent_failure``; those in the records.
    """

    cell: str
    world: str
    kind: str
    severity: float
    n: int
    confirmatory: bool
    worlds: int
    units: int
    worlds_with: tuple[int, ...]
    eq1: float | None
    weakest: float | None
    in_units: float
    saturated: bool
    p_independence: float | None
    p_forecast: float | None
    verdict_in_units: Verdict
    verdict_forecast: Verdict
    way_in_units: Interval | None
    way_forecast: Interval | None
    steps: dict[str, Interval]
    shares: dict[str, Interval]

    @property
    def measured(self) -> Interval:
        """D, with its interval by worlds."""
        return self.shares["dual_failure"]


def judge_cells(
    cells: Sequence[HomogeneousCell],
    threads: int,
    confirmatory: Sequence[str],
    rng: np.random.Generator,
    permutations: int | None = None,
    confirmatory_threads: int | None = None,
) -> tuple[JudgedCell, ...]:
    """Judge cells with the first 1 to ``threads`` threads, by n and then in the order of the cells.

    Holm's correction is made over the confirmatory cells and numbers of threads, and over the others apart.
    Confirmatory are cells of these names with the first 1 to ``confirmatory_threads`` threads, or all.
    """
    most = threads if confirmatory_threads is None else confirmatory_threads
    number = permutations or permutations_for(len(cells) * threads)
    pairs = [(n, cell) for n in range(1, threads + 1) for cell in cells if cell.units]
    named = [n <= most and cell.name in confirmatory for n, cell in pairs]
    of = [cell.usable(n) for n, cell in pairs]
    tested = {
        i: (compare_units(outcomes, independence(outcomes, rng, number)), compare_forecast(outcomes))
        for i, outcomes in enumerate(of)
        if len(outcomes.breakage) > 1 + outcomes.threads
    }
    found: dict[int, tuple[tuple[Verdict, Verdict], float | None, float | None]] = {}
    for family in (True, False):
        own = [i for i in tested if named[i] == family]
        units, forecasts = ([tested[i][which] for i in own] for which in (0, 1))
        words = zip(*verdicts(units, forecasts), strict=True)
        found |= dict(zip(own, zip(words, corrected(units), corrected(forecasts), strict=True), strict=True))
    untested = (Verdict.UNTESTED, Verdict.UNTESTED), None, None
    judged = []
    for i, (n, cell) in enumerate(pairs):
        outcomes = of[i]
        if not len(outcomes.breakage):
            continue
        in_units, forecast = tested.get(i, (None, None))
        (on_units, on_forecast), p_units, p_forecast = found.get(i, untested)
        happened = np.nansum(outcomes.columns, axis=(2, 3)) > 0
        judged.append(
            JudgedCell(
                cell=cell.name,
                world=cell.world,
                kind=cell.kind,
                severity=cell.severity,
                n=n,
                confirmatory=named[i],
                worlds=len(outcomes.breakage),
                units=int(np.isfinite(outcomes.breakage).sum()),
                worlds_with=tuple(map(int, happened.sum(axis=1))),
                eq1=in_units.product.value if in_units else None,
                weakest=in_units.weakest.value if in_units else None,
                in_units=measured_in_units(outcomes).value,
                saturated=in_units is not None and in_units.saturated,
                p_independence=p_units,
                p_forecast=p_forecast,
                verdict_in_units=on_units,
                verdict_forecast=on_forecast,
                way_in_units=_way(in_units) if in_units else None,
                way_forecast=_way(forecast) if forecast else None,
                steps=_steps(outcomes) if in_units else {},
                shares=_shares(cell, n),
            )
        )
    return tuple(judged)


def _way(found: Comparison) -> Interval | None:
    return way_interval(found.measured, found.product, found.weakest)


def _steps(outcomes: Outcomes) -> dict[str, Interval]:
    """The steps of the chain with their intervals."""
    ratios = {
        # Only a product of margins has the variance of a product of counts.
        name: ratio_of_shares(*pair, outcomes.margins if name in ("world", "sequence", "whole") else ())
        for name, pair in chain(outcomes).items()
    }
    return {name: ratio for name, ratio in ratios.items() if ratio is not None}


def ratio_of_shares(
    numerator: Figure, denominator: Figure, shares: tuple[float, ...] = ()
) -> Interval | None:
    """Ratio of two shares with its interval, never below 0; None where it is not determined.

    Args:
        numerator, denominator: over the same worlds.
        shares: whose product the denominator estimates, if it does.
    """
    if numerator.worlds < 3 or not np.isfinite([*numerator.without, *denominator.without]).all():
        return None
    rare = shares if few_events(numerator.pseudo_values, shares) else None
    ratio = ratio_interval(numerator, denominator, rare)
    if ratio is None or not isfinite(ratio.value):
        return None
    return Interval(ratio.value, min(max(0.0, ratio.low), ratio.value), ratio.high)


def share_among(event: Figure, among: Figure) -> Interval | None:
    """Share of an event among the units of a part, both over the same worlds; None if there are none."""
    if among.value <= 0:
        return None
    value = event.value / among.value
    if value > 0.5:  # of what is rare the spread over the worlds may not be known, also if it is the rest
        rest = share_among(among - event, among)
        return rest and Interval(value, min(1 - rest.high, value), max(1 - rest.low, value))
    found = ratio_of_shares(event, among)
    return Interval(value, found.low, min(1.0, found.high)) if found else Interval(value, 0.0, 1.0)


def share_of_part(event: Floats, part: Floats) -> Interval | None:
    """Share of an event among the units of a part, (W, S, K) each, 0 or 1, NaN for no unit; None for none.

    The ratio of the two shares, so that a world counts by what it has of the part: the mean of each world's
    own share would weigh a world with one unit of it like one with all.
    """
    inside = np.where(np.isfinite(event), part, np.nan)
    shares = (world_means(x) for x in (event * inside, inside))
    return share_among(*(Figure.mean(means[np.isfinite(means)]) for means in shares))


def share_of_chance(cells: Sequence[HomogeneousCell]) -> Interval | None:
    """1 - ICC of B over cells, each in its own worlds: its variance that is chance, not the sequence's.

    None without repeats, without a cell of at least 3 worlds, or where B does not vary.
    """
    kept = [outcomes for cell in cells if len((outcomes := cell.usable(1)).breakage) > 2]
    known = [found for o in kept if (found := correlation_in_sequences(o.breakage)) is not None]
    if not known or len(known) < len(kept):
        return None
    worlds = [outcomes.worlds for outcomes in kept]
    chance = over_cells([of_cell - within for within, of_cell in known], worlds)
    ratio = ratio_interval(chance, over_cells([of_cell for _, of_cell in known], worlds))
    return Interval(*(min(max(0.0, x), 1.0) for x in (ratio.value, ratio.low, ratio.high))) if ratio else None


def _shares(cell: HomogeneousCell, n: int) -> dict[str, Interval]:
    """Shares of units by world, over the units that every figure at this n uses."""
    valid = np.isfinite(cell.outcomes.of_first(n).breakage)
    events: dict[str, Floats | None] = {
        "breakage": cell.outcomes.breakage,
        "dual_failure": cell.outcomes.dual_failures[n - 1],
        "system_failure": cell.events_said(failure_column("s", n)),
        "mission_failure": cell.events_said(failure_column("m", n)),
        "base_mission_failure": cell.events_said("base_mission_failure"),
    }
    found = {name: share_by_world(np.where(valid, e, np.nan)) for name, e in events.items() if e is not None}
    if cell.says("silent_failure"):
        unbroken = np.where(valid, cell.outcomes.breakage == 0, np.nan)
        found["silent_failure"] = share_of_part(cell.events("silent_failure"), unbroken)
    return {name: share for name, share in found.items() if share is not None}


def share_by_world(event: Floats) -> Interval | None:
    """Share of an event, (W, S, K) with NaN for no unit, with its interval by worlds; None without units."""
    means = world_means(event)
    means = means[np.isfinite(means)]
    return share_interval(means) if len(means) else None
