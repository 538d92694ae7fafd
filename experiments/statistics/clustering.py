"""Intervals for units that share worlds: the cluster bootstrap and a GEE."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import statsmodels.api as sm
from numpy.typing import ArrayLike
from scipy.stats import norm, t

from experiments.statistics.joint import Bools, Floats
from experiments.statistics.results import Estimate

_NO_SPREAD = 1e-9
_PERCENTILE = "percentile interval widened for their number"


def cluster_bootstrap(
    event: Bools, cluster: ArrayLike, draws: int, rng: np.random.Generator, confidence: float = 0.95
) -> Estimate:
    """Share of units with an event, its interval by resampling whole clusters.

    Percentile interval, widened for the number of clusters as Student's t is over the normal. There is no
    interval for fewer than two clusters, or if all clusters agree (resampling then has no spread).

    Source: Hesterberg, "What teachers should know about the bootstrap", American Statistician 2015, Sec. 3.
    """
    method = f"worlds resampled, {_PERCENTILE}"
    if event.size == 0:
        return Estimate.undetermined(method)
    share = float(event.mean())
    if share in (0.0, 1.0):
        return Estimate(share, None, None, method)
    found = cluster_ratio(event.astype(float), np.ones(event.size), cluster, draws, rng, method, confidence)
    agree = found.low is not None and found.high is not None and found.high - found.low < _NO_SPREAD
    return replace(found, low=None, high=None) if agree else found


def cluster_ratio(
    over: Floats,
    under: Floats,
    cluster: ArrayLike,
    draws: int,
    rng: np.random.Generator,
    method: str,
    confidence: float = 0.95,
) -> Estimate:
    """Ratio of two sums over units, its interval by resampling whole clusters as `cluster_bootstrap` does.

    Args:
        over: (N,) summands of the numerator.
        under: (N,) of the denominator, each above 0.
        cluster: (N,) labels.
        draws: of the bootstrap.
        rng: of the bootstrap.
        method: description of the estimator.
        confidence: of the interval.
    """
    if not (under > 0).all():
        raise ValueError("summands of the denominator must be above 0")
    if under.size == 0:
        return Estimate.undetermined(method)
    value = float(over.sum() / under.sum())
    index, clusters = _numbered(cluster)
    if clusters < 2:
        return Estimate(value, None, None, method)
    weights = _resampled(clusters, draws, rng)
    ratios = (weights @ np.bincount(index, weights=over)) / (weights @ np.bincount(index, weights=under))
    return Estimate(value, *_percentiles(ratios, clusters, confidence), method)


def cluster_median(
    values: Floats, cluster: ArrayLike, draws: int, rng: np.random.Generator, confidence: float = 0.95
) -> Estimate:
    """Median of units, its interval by resampling whole clusters as `cluster_bootstrap` does."""
    method = f"median; worlds resampled, {_PERCENTILE}"
    if values.size == 0:
        return Estimate.undetermined(method)
    value = float(np.median(values))
    index, clusters = _numbered(cluster)
    if clusters < 2:
        return Estimate(value, None, None, method)
    order = np.argsort(values, kind="stable")
    heights = np.cumsum(_resampled(clusters, draws, rng)[:, index[order]], axis=1)
    half = heights[:, -1:] / 2
    # The median of an even number of units is the mean of the middle two.
    lower, upper = (values[order][reached.argmax(axis=1)] for reached in (heights >= half, heights > half))
    return Estimate(value, *_percentiles((lower + upper) / 2, clusters, confidence), method)


def _numbered(cluster: ArrayLike) -> tuple[np.ndarray, int]:
    """(N,) index of each unit's cluster, and the number of clusters."""
    names, index = np.unique(np.asarray(cluster), return_inverse=True)
    return index, len(names)


def _resampled(clusters: int, draws: int, rng: np.random.Generator) -> np.ndarray:
    """(draws, clusters) multiplicity of each cluster in each draw."""
    return rng.multinomial(clusters, np.full(clusters, 1 / clusters), size=draws)


def _percentiles(drawn: Floats, clusters: int, confidence: float) -> tuple[float, float]:
    tail = norm.cdf(math.sqrt(clusters / (clusters - 1)) * t.ppf((1 - confidence) / 2, clusters - 1))
    low, high = np.quantile(drawn, [tail, 1 - tail])
    return float(low), float(high)


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
        within: (N,) label of a group with its own intercept, the cell; groups in which the event always or
            never happens do not inform the odds and are left out.
        confidence: of the interval.
    """
    method = "GEE odds ratio, exchangeable within worlds, robust errors"
    cluster, group = np.asarray(cluster), np.zeros(event.size) if within is None else np.asarray(within)
    rates = (
        pd.Series(event.astype(float)).groupby(group).transform("mean").to_numpy() if event.size else event
    )
    varied = (rates > 0) & (rates < 1) if event.size else np.zeros(0, bool)
    event, factor, cluster, group = event[varied], factor[varied], cluster[varied], group[varied]
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
    """A coefficient and its interval; all None if the fit does not converge."""
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
    if half < _NO_SPREAD:  # the clusters agree, and say nothing about others
        return value, None, None
    return value, value - half, value + half
