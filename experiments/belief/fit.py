"""The model's parameters, by what right and wrong hypotheses have shown."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import logsumexp

from dslab.experiments.belief.logs import Asked
from dslab.scenarios.errors import InputError
from dslab.slam.belief.ledger import Ledger
from dslab.slam.belief.model import (
    LOG_WEIGHT,
    Parameters,
    Sight,
    by_share,
    by_surface,
    log_prior_of_share,
    prior,
    told,
)

_MOST_VIEWS = 800
"""Right and wrong ones each: views of one hypothesis say much the same."""
_SPREAD = np.array([1.0, 2.0, 0.5, 0.3, 0.3])


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
        offset, angle, zoom, view, surface = x
        return replace(
            start, offset=float(offset), angle=float(max(angle, 0.0)), zoom=float(max(zoom, 0.0)),
            view=float(np.exp(view)), surface=float(np.exp(surface)),
        )  # fmt: skip

    def here(sight: Sight, p: Parameters) -> float:
        return float(logsumexp(by_surface(told(sight, p), sight.cell).sum(axis=1) + LOG_WEIGHT))

    x = np.array([start.offset, start.angle, start.zoom, np.log(start.view), np.log(start.surface)])
    simplex = x + np.vstack([np.zeros(len(x)), np.diag(_SPREAD)])
    found = minimize(
        lambda x: -np.mean([here(sight, of(x)) for sight in right]), x, method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 1e-3, "initial_simplex": simplex},
    )  # fmt: skip
    return fit_alternatives(asked, of(found.x))


def fit_alternatives(asked: Sequence[Asked], parameters: Parameters) -> Parameters:
    """What places are taken for others, and how often, so that beliefs are as often right as they say."""

    def of(x: np.ndarray) -> Parameters:
        a, b, at_once, per_area, of_loops = map(float, np.exp(np.clip(x, -12.0, 12.0)))
        return replace(parameters, alike=(a, b), at_once=at_once, per_area=per_area, of_loops=of_loops)

    false = np.array([one.false for one in asked])
    here, shares = zip(*(_told_by(one, parameters) for one in asked), strict=True)

    def loss(x: np.ndarray) -> float:
        p = of(x)
        elsewhere = logsumexp(np.array(shares) + log_prior_of_share(p), axis=1)
        before = np.array([prior(one.unseen, p, one.kind == "loop") for one in asked])
        odds = before + np.array(here) - elsewhere
        return float(np.logaddexp(0, np.where(false, odds, -odds)).mean())

    p = parameters
    x = np.log([*p.alike, p.at_once, p.per_area, p.of_loops])
    simplex = x + np.vstack([np.zeros(len(x)), np.eye(len(x))])
    found = minimize(
        loss, x, method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 1e-5, "maxiter": 4000, "initial_simplex": simplex},
    )  # fmt: skip
    return of(found.x)


def _told_by(one: Asked, parameters: Parameters) -> tuple[float, np.ndarray]:
    """Evidence of here, and (G,) of places that are alike in each share, of a hypothesis by all its views."""
    ledger = Ledger(parameters)
    for sight in one.sights:
        ledger.add(sight)
    of_cell = ledger.of_cell()
    return float(of_cell.sum()), by_share(of_cell)[:, 0]


def _views(asked: Sequence[Asked], false: bool) -> list[Sight]:
    """Sights of right or of wrong hypotheses, evenly thinned to a number that can be fitted."""
    sights = [sight for one in asked if one.false == false for sight in one.sights if len(sight.point)]
    step = max(len(sights) / _MOST_VIEWS, 1.0)
    return [sights[int(i * step)] for i in range(int(len(sights) / step))]
