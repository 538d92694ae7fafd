"""Which formula predicts dual failures: each is fitted without one world and scored on it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy import stats
from scipy.optimize import minimize_scalar
from scipy.special import ndtr, ndtri

from dslab.experiments.statistics.estimates import Figure, mean_over_cells
from dslab.experiments.statistics.outcomes import Floats, Outcomes, world_means
from dslab.experiments.statistics.verdicts import holm
from dslab.experiments.statistics.world_intervals import Interval, difference_interval

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
    cells: Sequence[Outcomes], fitted: Sequence[bool]
) -> tuple[list[FormulaScore], list[FormulaScore]]:
    """Score Eq. 1, its rivals and the ceiling on D and on Q, one world left out of all its cells at a time.

    Args:
        cells: with the same threads and a unit in each of their worlds.
        fitted: cells that the rivals' parameters are fitted to, by their Q: tested and unsaturated ones.

    Returns:
        For D and for Q the scores of ``FORMULAS``; the ceiling is the mean outcome of the other worlds.
    """
    means = [world_means(cell.columns) for cell in cells]  # (n + 1, W) each
    units = [world_means(np.prod(cell.columns, axis=0)) for cell in cells]
    failures = [world_means(cell.dual_failures[-1]) for cell in cells]
    chosen = np.asarray(fitted)
    p = np.array([(x.sum(axis=1) + 0.5) / (x.shape[1] + 1) for x in means])
    q = np.array([x.mean() for x in units])
    places = [{world: i for i, world in enumerate(cell.worlds)} for cell in cells]
    predicted = [np.empty((len(RIVALS) + 1, len(own))) for own in places]
    for world in dict.fromkeys(world for own in places for world in own):
        inside = {c: own[world] for c, own in enumerate(places) if world in own}
        p_others, q_others = p.copy(), q.copy()
        for c, i in inside.items():
            p_others[c] = (means[c].sum(axis=1) - means[c][:, i] + 0.5) / means[c].shape[1]
            q_others[c] = np.delete(units[c], i).mean()
        beta, r = fit_factors(p_others[chosen], q_others[chosen])
        found = (eq1(p_others), weakest_link(p_others), beta_factor(p_others, beta), one_factor(p_others, r))
        for c, i in inside.items():
            predicted[c][:, i] = [of_all[c] for of_all in found]
    parameters = dict(zip(RIVALS[1:], fit_factors(p[chosen], q[chosen]), strict=True))
    on_dual_failures, on_units = (_scores(cells, predicted, y, parameters) for y in (failures, units))
    return on_dual_failures, on_units


def _scores(
    cells: Sequence[Outcomes],
    predicted: Sequence[Floats],
    outcomes: Sequence[Floats],
    parameters: Mapping[str, float],
) -> list[FormulaScore]:
    """Scores of what Eq. 1 and its rivals predict, (4, W) per cell, on (W,) means of an outcome."""
    limited = [
        np.clip([*four, (y.sum() - y + 0.5) / len(y)], 0.5 / len(y), 1 - 0.5 / len(y))
        for four, y in zip(predicted, outcomes, strict=True)
    ]
    losses = [-(y * np.log(f) + (1 - y) * np.log(1 - f)) for f, y in zip(limited, outcomes, strict=True)]
    calibrations = np.array([(f - y).mean(axis=1) for f, y in zip(limited, outcomes, strict=True)])
    worlds = [cell.worlds for cell in cells]
    of = {name: mean_over_cells([loss[i] for loss in losses], worlds) for i, name in enumerate(FORMULAS)}
    gains = {name: of["Eq. 1"] - loss for name, loss in of.items() if name != "Eq. 1"}
    p = dict(zip(RIVALS, holm([_p_of_gain(gains[name]) for name in RIVALS]), strict=True))
    return [
        FormulaScore(
            name,
            loss.value,
            difference_interval(gains[name]) if name in gains else None,
            p.get(name),
            calibration,
            parameters.get(name),
        )
        for (name, loss), calibration in zip(of.items(), calibrations.T, strict=True)
    ]


def second_thread_gain(outcomes: Outcomes) -> Floats:
    """(W,) D of the first thread alone minus D of all, per world."""
    return world_means(outcomes.dual_failures[0]) - world_means(outcomes.dual_failures[-1])


def fit_factors(p: Floats, measured: Floats) -> tuple[float, float]:
    """The beta factor's beta and the one-factor model's r, see :func:`fit_parameter`."""
    return fit_parameter(beta_factor, p, measured), fit_parameter(one_factor, p, measured)


def fit_parameter(formula: Callable[[Floats, float], Floats], p: Floats, measured: Floats) -> float:
    """Parameter in [0, 1] of greatest likelihood of the measured means; 0 without cells."""
    if not len(p):
        return 0.0

    def loss(parameter: float) -> float:
        f = np.clip(formula(p, parameter), 1e-9, 1 - 1e-9)
        return float(-(measured * np.log(f) + (1 - measured) * np.log(1 - f)).sum())

    best = minimize_scalar(loss, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-4}).x
    return float(min((0.0, 1.0, best), key=loss))


def _p_of_gain(gain: Figure) -> float:
    return float(stats.t.sf(gain.t, gain.freedom)) if gain.t else 1.0
