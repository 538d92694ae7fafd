"""A failure probability against severity: logistic curve with band, and the severity of 50% failures.

The prior is Jeffreys' (its mode is Firth's estimate), so that severities which separate failure from success
completely still give a finite curve with a wide interval.
"""

import math
from collections.abc import Sequence

import numpy as np

from experiments.statistics.joint import Floats
from experiments.statistics.results import DosePoint, DoseResponse, Estimate

_GRID = 81
_REACH = 5.0
_CURVE_POINTS = 41
_METHOD = "logistic, Jeffreys prior (Firth); interval of the posterior"


def dose_response(
    kind: str, quantity: str, points: Sequence[DosePoint], confidence: float = 0.95
) -> DoseResponse:
    """Fit the curve to the points that have units.

    With fewer than two severities nothing is fitted. The severity of 50% has bounds only if the posterior
    distinguishes a rising from a falling curve; outside the tested range it relies on the curve's form.

    Source: Firth, "Bias reduction of maximum likelihood estimates", Biometrika 1993; Heinze & Schemper,
        Statistics in Medicine 2002.
    """
    used = [p for p in points if p.proportion.units]
    x = np.array([p.severity for p in used], float)
    if np.unique(x).size < 2:
        none = Estimate.undetermined(_METHOD)
        return DoseResponse(kind, quantity, tuple(points), none, none, (), none)
    events = np.array([p.proportion.events for p in used], float)
    units = np.array([p.proportion.units for p in used], float)
    centre, scale = float((x.max() + x.min()) / 2), float((x.max() - x.min()) / 2)
    z = (x - centre) / scale
    mode = _firth(z, events, units)
    level, slope, weight = _posterior(z, events, units, mode)
    tails = [(1 - confidence) / 2, (1 + confidence) / 2]
    natural_slope, intercept = slope / scale, level - slope * centre / scale
    where = np.linspace(-1, 1, _CURVE_POINTS)
    curve = tuple(
        (
            float(centre + scale * s),
            _logistic(mode[0] + mode[1] * s),
            *(_logistic(q) for q in _quantiles(level + slope * s, weight, tails)),
        )
        for s in where
    )
    return DoseResponse(
        kind,
        quantity,
        tuple(points),
        Estimate(float(mode[1] / scale), *_quantiles(natural_slope, weight, tails), _METHOD),
        Estimate(float(mode[0] - mode[1] * centre / scale), *_quantiles(intercept, weight, tails), _METHOD),
        curve,
        _half(mode, level, slope, weight, tails, centre, scale),
    )


def _half(
    mode: Floats,
    level: Floats,
    slope: Floats,
    weight: Floats,
    tails: list[float],
    centre: float,
    scale: float,
) -> Estimate:
    """Severity of 50%: bounded if the slope's sign is known at the stated confidence."""
    rising = float(weight[slope > 0].sum())
    method = f"severity of 50%; {_METHOD}"
    value = float(centre - scale * mode[0] / mode[1]) if abs(mode[1]) > 1e-9 else None
    if tails[0] < rising < tails[1]:
        return Estimate(value, None, None, method + "; sign of the slope not known")
    safe = np.where(np.abs(slope) > 1e-12, slope, 1e-12)
    return Estimate(value, *_quantiles(centre - scale * level / safe, weight, tails), method)


def _firth(z: Floats, events: Floats, units: Floats, steps: int = 200) -> Floats:
    """Mode of the posterior: Newton steps on Firth's modified score, halved until the posterior rises."""
    design = np.column_stack([np.ones_like(z), z])
    found = np.zeros(2)
    height = float(_log_posterior(found[:1], found[1:], z, events, units)[0])
    for _ in range(steps):
        p = 1 / (1 + np.exp(-design @ found))
        weight = units * p * (1 - p)
        information = design.T @ (weight[:, None] * design)
        leverage = weight * np.einsum("ij,jk,ik->i", design, np.linalg.inv(information), design)
        step = np.linalg.solve(information, design.T @ (events - units * p + leverage * (0.5 - p)))
        step *= min(1.0, 3.0 / (1e-300 + float(np.abs(step).max())))
        while True:
            new = float(_log_posterior(*(found + step)[:, None], z, events, units)[0])
            if new >= height or float(np.abs(step).max()) < 1e-10:
                break
            step = step / 2
        found, height = found + step, new
        if float(np.abs(step).max()) < 1e-9:
            break
    return found


def _posterior(z: Floats, events: Floats, units: Floats, mode: Floats) -> tuple[Floats, Floats, Floats]:
    """Points of the posterior and their weights, on a grid along the curvature at its mode.

    The grid is dense at the mode and reaches 74 standard errors, for the heavy tails of separated data.
    """
    p = 1 / (1 + np.exp(-(mode[0] + mode[1] * z)))
    weight = units * p * (1 - p)
    information = np.array([[weight.sum(), weight @ z], [weight @ z, weight @ z**2]])
    root = np.linalg.cholesky(np.linalg.inv(information))
    u = np.linspace(-_REACH, _REACH, _GRID)
    step, jacobian = np.sinh(u), np.cosh(u)
    first, second = (grid.ravel() for grid in np.meshgrid(step, step, indexing="ij"))
    level = mode[0] + root[0, 0] * first
    slope = mode[1] + root[1, 0] * first + root[1, 1] * second
    log_weight = _log_posterior(level, slope, z, events, units)
    log_weight += np.log(np.outer(jacobian, jacobian).ravel())
    found = np.exp(log_weight - log_weight.max())
    return level, slope, found / found.sum()


def _log_posterior(level: Floats, slope: Floats, z: Floats, events: Floats, units: Floats) -> Floats:
    total = np.zeros(level.shape)
    information = [np.zeros(level.shape) for _ in range(3)]
    for x, k, n in zip(z, events, units, strict=True):
        logit = level + slope * x
        absolute = np.abs(logit)
        tail = np.exp(-absolute)
        total += k * logit - n * (np.maximum(logit, 0) + np.log1p(tail))
        weight = n * tail / (1 + tail) ** 2
        for power in range(3):
            information[power] += weight * x**power
    determinant = information[0] * information[2] - information[1] ** 2
    return total + 0.5 * np.log(np.maximum(determinant, 1e-300))


def _quantiles(values: Floats, weight: Floats, tails: list[float]) -> tuple[float, float]:
    order = np.argsort(values)
    heights = np.cumsum(weight[order]) - weight[order] / 2
    low, high = np.interp(tails, heights, values[order])
    return float(low), float(high)


def _logistic(x: float) -> float:
    return 1 / (1 + math.exp(-max(min(x, 500.0), -500.0)))
