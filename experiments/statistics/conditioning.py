"""Pose error of two views against their baseline: medians per gap, and slopes within lead-ins."""

from itertools import pairwise

import numpy as np
import pandas as pd

from experiments.eq1.records import PAIR_COLUMNS, PAIR_GAPS, Outcome, pair_column
from experiments.statistics.clustering import cluster_median, cluster_ratio
from experiments.statistics.results import BaselineErrors, Estimate, GapErrors, GapSlope

QUANTITIES = ("rotation_deg", "direction_deg")
_METHOD = "least squares of logarithms within lead-ins; worlds resampled"


def lead_ins(table: pd.DataFrame) -> pd.DataFrame:
    """The lead-ins of completed units whose pairs were judged, each once.

    Cells of one base share their lead-ins, which end before the degradation starts.

    Args:
        table: of units, with the columns of `experiments.eq1.records.columns`.
    """
    rows = table[table["outcome"] == Outcome.COMPLETED.value]
    judged = [pair_column(gap, name) for gap in PAIR_GAPS for name in PAIR_COLUMNS]
    measured = rows[[pair_column(gap, "baseline_m") for gap in PAIR_GAPS]].notna().any(axis=1)
    return rows[measured].drop_duplicates(["world_seed", "index", *judged])


def baseline_errors(
    rows: pd.DataFrame, quantity: str, draws: int, rng: np.random.Generator, confidence: float = 0.95
) -> BaselineErrors | None:
    """Relate an error of the relative pose to the baseline; None if no pair was judged.

    Every lead-in has its own level, so that hard worlds and fast cameras do not bias the slope: it measures
    the change of the error from gap to gap in one place.

    Args:
        rows: from `lead_ins`.
        quantity: ``rotation_deg`` or ``direction_deg``.
        draws: of the bootstrap over worlds.
        rng: of the bootstrap.
        confidence: of the intervals.
    """
    if not any(rows[pair_column(gap, quantity)].notna().any() for gap in PAIR_GAPS):
        return None
    gaps = []
    for gap in PAIR_GAPS:
        own = rows[rows[pair_column(gap, quantity)].notna()]
        if len(own):
            error, world = _floats(own, gap, quantity), own["world_seed"].to_numpy()
            gaps.append(
                GapErrors(
                    gap,
                    len(own),
                    int(own[pair_column(gap, "count")].sum()),
                    float(np.median(_floats(own, gap, "matches"))),
                    float(np.median(_floats(own, gap, "baseline_m"))),
                    cluster_median(error, world, draws, rng, confidence),
                )
            )
    measured = [g.gap for g in gaps]
    slopes = [
        GapSlope(narrow, wide, _slope(rows, quantity, [narrow, wide], draws, rng, confidence))
        for narrow, wide in pairwise(measured)
    ]
    whole = _slope(rows, quantity, measured, draws, rng, confidence)
    used = rows[_known(rows, quantity, measured).sum(axis=1) > 1]
    worlds = used["world_seed"].nunique()
    return BaselineErrors(quantity, len(used), worlds, tuple(gaps), whole, tuple(slopes))


def _slope(
    rows: pd.DataFrame,
    quantity: str,
    gaps: list[int],
    draws: int,
    rng: np.random.Generator,
    confidence: float,
) -> Estimate:
    """Slope of log error on log baseline; zeros, which have no logarithm, are left out."""
    baseline_m, error = _by_gap(rows, "baseline_m", gaps), _by_gap(rows, quantity, gaps)
    known = _known(rows, quantity, gaps)
    enough = known.sum(axis=1) > 1
    known, baseline_m, error = known[enough], baseline_m[enough], error[enough]
    x = _about_own_mean(np.log(np.where(known, baseline_m, 1.0)), known)
    y = _about_own_mean(np.log(np.where(known, error, 1.0)), known)
    world = rows["world_seed"].to_numpy()[enough]
    return cluster_ratio((x * y).sum(axis=1), (x * x).sum(axis=1), world, draws, rng, _METHOD, confidence)


def _known(rows: pd.DataFrame, quantity: str, gaps: list[int]) -> np.ndarray:
    """(N, G) bool, true if error and baseline both have a logarithm."""
    return (_by_gap(rows, "baseline_m", gaps) > 0) & (_by_gap(rows, quantity, gaps) > 0)


def _by_gap(rows: pd.DataFrame, name: str, gaps: list[int]) -> np.ndarray:
    """(N, G) one column, for every gap."""
    return np.column_stack([_floats(rows, gap, name) for gap in gaps])


def _about_own_mean(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(N, G) values minus the mean of each row's known ones; 0 where unknown."""
    means = (values * known).sum(axis=1, keepdims=True) / known.sum(axis=1, keepdims=True)
    return np.where(known, values - means, 0.0)


def _floats(rows: pd.DataFrame, gap: int, name: str) -> np.ndarray:
    """A column as (N,) float64, nulls as NaN."""
    return rows[pair_column(gap, name)].to_numpy(float, na_value=np.nan)
