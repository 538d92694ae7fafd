"""Pose error of two views against their baseline: means per gap, and slopes within lead-ins, by worlds."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd

from dslab.experiments.eq1.records import PAIR_COLUMNS, PAIR_GAPS, Outcome, pair_column
from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.products import ROUNDING
from dslab.experiments.statistics.world_intervals import Interval, ratio_interval

QUANTITIES = ("rotation_deg", "direction_deg")


@dataclass(frozen=True)
class GapErrors:
    """Errors of the pairs of frames with one gap.

    Attributes:
        gap: in frames.
        lead_ins, pairs: their numbers.
        matches, baseline_m: medians over lead-ins.
        error: median over lead-ins, in degrees.
    """

    gap: int
    lead_ins: int
    pairs: int
    matches: float
    baseline_m: float
    error: float


@dataclass(frozen=True)
class GapSlope:
    """Slope of log error on log baseline between two gaps; None where it is not determined."""

    narrow: int
    wide: int
    slope: Interval | None


@dataclass(frozen=True)
class BaselineErrors:
    """An error of the relative pose against the baseline.

    Attributes:
        quantity: one of ``QUANTITIES``.
        lead_ins, worlds: their numbers.
        gaps: errors per gap.
        slope: over all gaps.
        steps: slopes between neighbouring gaps.
    """

    quantity: str
    lead_ins: int
    worlds: int
    gaps: tuple[GapErrors, ...]
    slope: Interval | None
    steps: tuple[GapSlope, ...]


def lead_ins(table: pd.DataFrame) -> pd.DataFrame:
    """The lead-ins of completed units whose pairs were judged, each once.

    Cells of one base share their lead-ins, which end before the degradation starts.
    """
    judged = [pair_column(gap, name) for gap in PAIR_GAPS for name in PAIR_COLUMNS]
    if not set(judged) <= set(table.columns):
        return table.iloc[:0]
    completed = (table["outcome"] == Outcome.COMPLETED.value).fillna(False)
    rows: pd.DataFrame = table.loc[completed.astype(bool), :]
    measured = rows[[pair_column(gap, "baseline_m") for gap in PAIR_GAPS]].notna().any(axis=1)
    first = ~rows.duplicated(["world", "world_seed", "index", *judged])
    return rows.loc[measured & first, :]


def baseline_errors(rows: pd.DataFrame, quantity: str) -> BaselineErrors | None:
    """Relate an error of the relative pose to the baseline; None if no pair was judged.

    Every lead-in has its own level, so that hard worlds and fast cameras do not bias the slope: it measures
    the change of the error from gap to gap in one place.
    """
    gaps = []
    for gap in PAIR_GAPS if len(rows) else ():
        own = rows[rows[pair_column(gap, quantity)].notna()]
        if len(own):
            names = ("matches", "baseline_m", quantity)
            medians = (float(np.median(_by_gap(own, name, [gap]))) for name in names)
            gaps.append(GapErrors(gap, len(own), int(own[pair_column(gap, "count")].sum()), *medians))
    if not gaps:
        return None
    measured = [g.gap for g in gaps]
    used = rows[_known(rows, quantity, measured).sum(axis=1) > 1]
    return BaselineErrors(
        quantity,
        len(used),
        len(used[["world", "world_seed"]].drop_duplicates()),
        tuple(gaps),
        _slope(rows, quantity, measured),
        tuple(GapSlope(a, b, _slope(rows, quantity, [a, b])) for a, b in pairwise(measured)),
    )


def _slope(rows: pd.DataFrame, quantity: str, gaps: list[int]) -> Interval | None:
    """Least-squares slope of log error on log baseline; zeros, which have no logarithm, are left out."""
    known = _known(rows, quantity, gaps)
    enough = known.sum(axis=1) > 1
    if not enough.any():
        return None
    x, y = (
        _about_own_mean(np.log(np.where(known, _by_gap(rows, name, gaps), 1.0))[enough], known[enough])
        for name in ("baseline_m", quantity)
    )
    sums = pd.DataFrame({"xy": (x * y).sum(axis=1), "xx": (x * x).sum(axis=1)})
    by_world = sums.groupby([rows[name].to_numpy()[enough] for name in ("world", "world_seed")]).mean()
    xy, xx = (Figure.mean(by_world[name].to_numpy()) for name in ("xy", "xx"))
    if xx.value <= 0:
        return None
    if len(by_world) < 2:
        slope = xy.value / xx.value
        return Interval(slope, -np.inf, np.inf)
    return ratio_interval(xy, xx)


def _known(rows: pd.DataFrame, quantity: str, gaps: list[int]) -> np.ndarray:
    """(N, G) bool, true if error and baseline both have a logarithm."""
    return (_by_gap(rows, "baseline_m", gaps) > 0) & (_by_gap(rows, quantity, gaps) > 0)


def _by_gap(rows: pd.DataFrame, name: str, gaps: list[int]) -> np.ndarray:
    """(N, G) one column, for every gap, nulls as NaN."""
    return rows[[pair_column(gap, name) for gap in gaps]].to_numpy(float, na_value=np.nan)


def _about_own_mean(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(N, G) values minus the mean of each row's known ones; 0 where unknown."""
    means = (values * known).sum(axis=1, keepdims=True) / known.sum(axis=1, keepdims=True)
    apart = values - means
    return np.where(known & (np.abs(apart) > ROUNDING * np.abs(means)), apart, 0.0)
