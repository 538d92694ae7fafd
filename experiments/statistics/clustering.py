"""Units that share a world are not independent: intervals that resample worlds, and a GEE beside them."""

import math
import warnings

import numpy as np
import pandas as pd
import statsmodels.api as sm
from numpy.typing import ArrayLike
from scipy.stats import norm, t

from experiments.statistics.joint import Bools, Floats
from experiments.statistics.results import Estimate


def cluster_bootstrap(
    event: Bools, cluster: ArrayLike, draws: int, rng: np.random.Generator, confidence: float = 0.95
) -> Estimate:
    """Share of units with an event, its interval by resampling whole clusters.

    Percentile interval, widened for the number of clusters as Student's t is over the normal. It says nothing
    of fewer than two clusters, nor where all units agree (resampling then knows no spread).

    Source: Hesterberg, "What teachers should know about the bootstrap", American Statistician 2015, Sec. 3.
    """
    method = "worlds resampled, percentile interval widened for their number"
    if event.size == 0:
        return Estimate.undetermined(method)
    share = float(event.mean())
    _, index = np.unique(np.asarray(cluster), return_inverse=True)
    clusters = int(index.max()) + 1
    if clusters < 2 or share in (0.0, 1.0):
        return Estimate(share, None, None, method)
    sizes = np.bincount(index).astype(float)
    events = np.bincount(index, weights=event)
    weights = rng.multinomial(clusters, np.full(clusters, 1 / clusters), size=draws)
    shares = (weights @ events) / (weights @ sizes)
    tail = norm.cdf(math.sqrt(clusters / (clusters - 1)) * t.ppf((1 - confidence) / 2, clusters - 1))
    low, high = np.quantile(shares, [tail, 1 - tail])
    return Estimate(share, float(low), float(high), method)


def gee_share(event: Bools, cluster: ArrayLike, confidence: float = 0.95) -> Estimate:
    """Share of units with an event by a GEE (logit, exchangeable within clusters), robust errors."""
    method = "GEE, exchangeable within worlds, robust errors"
    if event.size == 0 or len(np.unique(np.asarray(cluster))) < 2 or event.all() or not event.any():
        return Estimate(float(event.mean()) if event.size else None, None, None, method)
    found = _fit(event, np.ones((event.size, 1)), cluster, 0, confidence)
    return Estimate(*(None if x is None else 1 / (1 + math.exp(-x)) for x in found), method)


def gee_odds_ratio(
    event: Bools, factor: Bools, cluster: ArrayLike, within: ArrayLike | None = None, confidence: float = 0.95
) -> Estimate:
    """Odds ratio of an event with to without a factor by a GEE, robust to units sharing a cluster.

    Args:
        event, factor: (N,) per observation.
        cluster: (N,) label, the world.
        within: (N,) label of a group with an intercept of its own, the cell; groups in which the event always
            or never happens say nothing of the odds and are left out.
        confidence: of the interval.
    """
    method = "GEE odds ratio, exchangeable within worlds, robust errors"
    cluster, group = np.asarray(cluster), np.zeros(event.size) if within is None else np.asarray(within)
    rates = (
        pd.Series(event.astype(float)).groupby(group).transform("mean").to_numpy() if event.size else event
    )
    telling = (rates > 0) & (rates < 1) if event.size else np.zeros(0, bool)
    event, factor, cluster, group = event[telling], factor[telling], cluster[telling], group[telling]
    corners = {(bool(e), bool(f)) for e, f in zip(event, factor, strict=True)}
    if len(corners) < 4 or len(np.unique(cluster)) < 2:
        return Estimate.undetermined(method)
    _, index = np.unique(group, return_inverse=True)
    design = np.column_stack([factor.astype(float), np.eye(int(index.max()) + 1)[index]])
    found = _fit(event, design, cluster, 0, confidence)
    return Estimate(*(None if x is None else math.exp(x) for x in found), method)


def _fit(
    event: Bools, design: Floats, cluster: ArrayLike, column: int, confidence: float
) -> tuple[float | None, float | None, float | None]:
    """A coefficient and its interval; all None where the fit does not settle."""
    order = np.argsort(np.asarray(cluster), kind="stable")
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            fitted = sm.GEE(
                event[order].astype(float),
                design[order],
                groups=np.asarray(cluster)[order],
                family=sm.families.Binomial(),
                cov_struct=sm.cov_struct.Exchangeable(),
            ).fit()
        except (ValueError, np.linalg.LinAlgError):
            return None, None, None
        if fitted is None:
            return None, None, None
        value, error = float(fitted.params[column]), float(fitted.bse[column])
    half = float(norm.ppf((1 + confidence) / 2)) * error
    if not (fitted.converged and math.isfinite(value) and math.isfinite(half) and abs(value) + half < 50):
        return None, None, None
    return value, value - half, value + half
