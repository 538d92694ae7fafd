"""Which formula predicts dual failures: each is fitted without one world and scored on it."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy import stats
from scipy.optimize import minimize_scalar
from scipy.special import ndtr, ndtri

from experiments.statistics.estimates import Figure
from experiments.statistics.outcomes import Floats, Outcomes, world_means
from experiments.statistics.verdicts import holm
from experiments.statistics.world_intervals import Interval, difference_interval

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(40)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()
RIVALS = ("weakest link", "beta factor", "one factor")
FORMULAS = ("Eq. 1", *RIVALS, "ceiling")


def eq1(p: Floats) -> Floats:
    """Eq. 1: (...) product of (..., n + 1) shares p0 and pr."""
    return p.prod(axis=-1)


def weakest_link(p: Floats) -> Floats:
    """The smallest of (..., n + 1) shares: what is hard for one is hard for all."""
    return p.min(axis=-1)


def beta_factor(p: Floats, beta: float) -> Floats:
    """Of the smallest share, ``beta`` in [0, 1] is a common cause; the rest is independent.

    Source: Fleming, "A reliability model for common mode failures", 1975, for unequal shares.
    """
    common = beta * p.min(axis=-1)
    rest = (p - common[..., None]) / np.maximum(1 - common[..., None], 1e-12)
    return common + (1 - common) * rest.prod(axis=-1)


def one_factor(p: Floats, r: float) -> Floats:
    """All depend on one normal factor with correlation ``r`` in [0, 1]; Eq. 1 to the last bit for 0.

    Source: Vasicek 1987; Gauss-Hermite quadrature with 40 nodes.
    """
    if r == 0:
        return eq1(p)  # the quadrature's rounding, alike in all worlds, would pass for a sure gain over Eq. 1
    r = min(r, 1 - 1e-9)
    arguments = (ndtri(p)[..., None] - sqrt(r) * _NODES) / sqrt(1 - r)
    return (ndtr(arguments).prod(axis=-2) * _WEIGHTS).sum(axis=-1)


@dataclass(frozen=True)
class FormulaScore:
    """How well a formula predicts worlds that it has not seen.

    Attributes:
        name: of the formula.
        score: mean over worlds and cells of -[y log f + (1 - y) log(1 - f)]; less is better.
        gain: of the score over Eq. 1's, with its interval by worlds; None for Eq. 1.
        p: one-sided, that it does not predict better than Eq. 1, by Holm over the rivals; None for others.
        calibration: (cells,) mean prediction minus mean outcome.
        parameter: the beta factor's beta and the one-factor model's r, fitted to all worlds; None for others.
    """

    name: str
    score: float
    gain: Interval | None
    p: float | None
    calibration: Floats
    parameter: float | None


def compare_formulas(
    cells: Sequence[Outcomes], fitted: Sequence[bool], on_units: bool = False
) -> list[FormulaScore]:
    """Score Eq. 1, its rivals and the ceiling, one world left out of all cells at a time.

    Args:
        cells: over the same worlds, with the same threads.
        fitted: cells that the rivals' parameters are fitted to, by their Q: tested and unsaturated ones.
        on_units: score on Q instead of D.

    Returns:
        Eq. 1, the weakest link, the beta factor, the one-factor model and the ceiling, which is the mean
        outcome of the other worlds.
    """
    means = np.stack([world_means(cell.columns) for cell in cells])  # (cells, n + 1, W)
    units = np.stack([world_means(np.prod(cell.columns, axis=0)) for cell in cells])
    outcome = units if on_units else np.stack([world_means(cell.dual_failures[-1]) for cell in cells])
    predicted = np.empty((len(FORMULAS), *outcome.shape))
    worlds = outcome.shape[1]
    for w in range(worlds):
        others = np.arange(worlds) != w
        p = (means[..., others].sum(axis=2) + 0.5) / worlds
        ceiling = (outcome[:, others].sum(axis=1) + 0.5) / worlds
        predicted[:, :, w] = [*_predictions(p, units[:, others].mean(axis=1), np.asarray(fitted)), ceiling]
    predicted = np.clip(predicted, 0.5 / worlds, 1 - 0.5 / worlds)
    loss = -(outcome * np.log(predicted) + (1 - outcome) * np.log(1 - predicted)).mean(axis=1)
    p = (means.sum(axis=2) + 0.5) / (worlds + 1)
    eq1_loss, *others = (Figure.mean(each) for each in loss)
    gains = [eq1_loss - other for other in others]
    parameters = dict(zip(RIVALS[1:], _parameters(p, units.mean(axis=1), np.asarray(fitted)), strict=True))
    p_rivals = dict(zip(RIVALS, holm([_p_of_gain(gain) for gain in gains[:3]]), strict=True))
    return [
        FormulaScore(
            name,
            float(loss[i].mean()),
            difference_interval(gains[i - 1]) if i else None,
            p_rivals.get(name),
            (predicted[i] - outcome).mean(axis=1),
            parameters.get(name),
        )
        for i, name in enumerate(FORMULAS)
    ]


def second_thread_gain(outcomes: Outcomes) -> Floats:
    """(W,) D of the first thread alone minus D of all, per world."""
    return world_means(outcomes.dual_failures[0]) - world_means(outcomes.dual_failures[-1])


def _predictions(p: Floats, measured: Floats, fitted: np.ndarray) -> list[Floats]:
    beta, r = _parameters(p, measured, fitted)
    return [eq1(p), weakest_link(p), beta_factor(p, beta), one_factor(p, r)]


def _parameters(p: Floats, measured: Floats, fitted: np.ndarray) -> tuple[float, float]:
    """The beta factor's beta and the one-factor model's r."""
    beta, r = (_fit(formula, p[fitted], measured[fitted]) for formula in (beta_factor, one_factor))
    return beta, r


def _fit(formula, p: Floats, measured: Floats) -> float:
    """Parameter in [0, 1] of greatest likelihood of the measured means; 0 without cells."""
    if not len(p):
        return 0.0

    def loss(parameter: float) -> float:
        f = np.clip(formula(p, parameter), 1e-9, 1 - 1e-9)
        return float(-(measured * np.log(f) + (1 - measured) * np.log(1 - f)).sum())

    best = minimize_scalar(loss, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-4}).x
    return float(min((0.0, 1.0, best), key=loss))


def _p_of_gain(gain: Figure) -> float:
    return float(stats.t.sf(gain.t, gain.worlds - 1)) if gain.t else 1.0
