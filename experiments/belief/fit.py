"""The model's parameters, by what right and wrong hypotheses have shown."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logit

from dslab.experiments.belief.logs import Asked
from dslab.scenarios.errors import InputError
from dslab.slam.belief.ledger import Ledger
from dslab.slam.belief.model import (
    SHARES,
    Parameters,
    Sight,
    evidence,
    log_density_of_torn,
    over_parts,
    prior,
)

_MOST_VIEWS = 100
"""Of right hypotheses, one of each at most: views of one say much the same."""
_BOUNDS = [(0.1, 1.5), (-3.0, 3.0), *[(0.0, 50.0)] * 3, (0.01, 1.5), (0.0, 1.5), (0.01, 3.0)]
_BOUNDS += [(0.0, 7.0), (-3.0, 1.0)]
_BROAD = np.array([1.0, 1.0, 3.0, 3.0, 1.0, 3.0, 2.0])
"""Deviations of the logarithms of what alternatives are, before any log: worlds are fewer than hypotheses,
and where all of these can be told apart nothing would hold the exponents."""


def fit(asked: Sequence[Asked], start: Parameters | None = None) -> Parameters:
    """Parameters of most likelihood.

    Those of what is seen at a place are told by views that are where they are supposed to be, against chance;
    those of the alternatives then by which hypotheses are right.

    Args:
        asked: hypotheses, right and wrong ones.
        start: to begin with; the model's own by default.

    Raises:
        InputError: none of them is right, or none is wrong.
    """
    start = start or Parameters()
    right, wrong = (_views(asked, false) for false in (False, True))
    if not right or not wrong:
        problem = f"no {'wrong' if right else 'right'} hypothesis with a view of points is among them"
        raise InputError("the logs", problem, "add batches of worlds that repeat themselves, with losses")

    def of(x: np.ndarray) -> Parameters:
        names = ("rate", "offset", "angle", "farther", "nearer", "view", "fall", "surface")
        here = float(np.exp(x[8])), float(np.exp(x[9]))
        return replace(start, **dict(zip(names, map(float, x[:8]), strict=True)), here=here)

    x = np.array([start.rate, start.offset, start.angle, start.farther, start.nearer, start.view, start.fall])
    x = np.append(x, [start.surface, *np.log(start.here)])
    found = minimize(
        lambda x: -np.mean([evidence(sight, of(x)).here for sight in right]), x, bounds=_BOUNDS,
        method="L-BFGS-B", options={"eps": 1e-3, "ftol": 1e-6},
    )  # fmt: skip
    return fit_torn(asked, fit_alternatives([one for one in asked if one.sights], of(found.x)))


def fit_alternatives(asked: Sequence[Asked], parameters: Parameters) -> Parameters:
    """What places are taken for others, and how often, so that beliefs are as often right as they say."""

    def of(x: np.ndarray) -> Parameters:
        a, b, *others = map(float, np.exp(np.clip(x[:-1], -12.0, 12.0)))
        return replace(
            parameters, alike=(a, b), lasting=float(expit(np.clip(x[-1], -9.0, 9.0))),
            **dict(zip(names, others, strict=True)),
        )  # fmt: skip

    names = ("doubles", "of_loops", "drift", "of_joins")
    false = np.array([one.false for one in asked])
    told = [Ledger(parameters, one.sights).by_part() for one in asked]
    of_parts = np.zeros((len(told), max(map(len, told)), SHARES))
    for row, parts in zip(of_parts, told, strict=True):
        row[: len(parts)] = parts
    runs, of_kind = len({one.run for one in asked}), Counter(one.kind for one in asked)
    weight = np.array([1 / (of_kind[one.kind] * len(of_kind)) for one in asked])  # a kind counts as a kind
    x = np.log([*parameters.alike, *(getattr(parameters, name) for name in names)])
    x = np.append(x, logit(parameters.lasting))
    broad = np.append(np.zeros(2), x[2:])

    def loss(y: np.ndarray) -> float:
        p = of(y)
        here, elsewhere = (over_parts(of_parts, beta, p.lasting) for beta in (p.here, p.alike))
        odds = here - elsewhere + [prior(one.unseen, p, one.kind) for one in asked]
        mean = float(weight @ np.logaddexp(0, np.where(false, odds, -odds)))
        return runs * mean + 0.5 * float((((y - broad) / _BROAD) ** 2).sum())

    simplex = x + np.vstack([np.zeros(len(x)), np.eye(len(x))])
    found = minimize(
        loss, x, method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 1e-4, "maxiter": 2000, "initial_simplex": simplex},
    )  # fmt: skip
    return of(found.x)


def fit_torn(asked: Sequence[Asked], parameters: Parameters) -> Parameters:
    """What right and wrong loops tear of a map; where few were asked, hardly changed."""
    here, elsewhere = (
        _beta([one.torn for one in asked if one.false == false and np.isfinite(one.torn)], before)
        for false, before in ((False, parameters.torn_here), (True, parameters.torn_elsewhere))
    )
    return replace(parameters, torn_here=here, torn_elsewhere=elsewhere)


def _beta(shares: Sequence[float], before: tuple[float, float]) -> tuple[float, float]:
    """Exponents of the likeliest Beta distribution, known to a factor of e before."""

    def loss(y: np.ndarray) -> float:
        a, b = map(float, np.exp(y))
        told = log_density_of_torn(np.array(shares), (a, b)).sum()
        return float(0.5 * ((y - np.log(before)) ** 2).sum() - told)

    a, b = np.exp(minimize(loss, np.log(before), method="Nelder-Mead").x)
    return float(a), float(b)


def _views(asked: Sequence[Asked], false: bool) -> list[Sight]:
    """Sights of right or of wrong hypotheses: the middle one of each, evenly thinned."""
    with_points = [[s for s in one.sights if len(s.point)] for one in asked if one.false == false]
    sights = [own[len(own) // 2] for own in with_points if own]
    step = max(len(sights) / _MOST_VIEWS, 1.0)
    return [sights[int(i * step)] for i in range(int(len(sights) / step))]
