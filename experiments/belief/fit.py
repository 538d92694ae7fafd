"""The model's parameters, by what right and wrong hypotheses have shown."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logit, logsumexp

from dslab.experiments.belief.logs import Asked
from dslab.scenarios.errors import InputError
from dslab.slam.belief.model import (
    LOG_WEIGHT,
    Parameters,
    Sight,
    by_surface,
    elsewhere,
    evidence_of_cells,
    told,
)

_MOST_VIEWS = 800
"""Right and wrong ones each: views of one hypothesis say much the same."""
_SPREAD = np.array([1.0, 2.0, 0.5, 0.3, 0.3])


def fit(asked: Sequence[Asked], start: Parameters | None = None) -> Parameters:
    """Parameters of most likelihood.

    Those of what is seen at a place are told by views that are where they are supposed to be, against chance;
    those of the alternatives then by views that are not.

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
    return fit_alternatives(wrong, of(found.x))


def fit_alternatives(wrong: Sequence[Sight], parameters: Parameters) -> Parameters:
    """γ and the weights of the places that wrong views are of, by their likelihood."""

    def of(x: np.ndarray) -> Parameters:
        part, double = sorted(map(float, expit(np.clip(x[:2], -12.0, 12.0))))
        weights = np.exp(np.append(0.0, np.clip(x[2:], -20.0, 20.0)))
        return replace(
            parameters, part=part, double=double, weights=tuple(map(float, weights / weights.sum()))
        )

    cells = [by_surface(told(sight, parameters), sight.cell) for sight in wrong]

    def loss(x: np.ndarray) -> float:
        p = of(x)
        return -float(np.mean([elsewhere(evidence_of_cells(each, p), p) for each in cells]))

    x = np.array([logit(parameters.part), logit(parameters.double), -1.0, -2.0])
    found = minimize(loss, x, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 1e-3})
    return of(found.x)


def _views(asked: Sequence[Asked], false: bool) -> list[Sight]:
    """Sights of right or of wrong hypotheses, evenly thinned to a number that can be fitted."""
    sights = [sight for one in asked if one.false == false for sight in one.sights if len(sight.point)]
    step = max(len(sights) / _MOST_VIEWS, 1.0)
    return [sights[int(i * step)] for i in range(int(len(sights) / step))]
