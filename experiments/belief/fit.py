"""The model's parameters, by what right and wrong hypotheses have shown."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logit

from dslab.experiments.belief.logs import Asked
from dslab.slam.belief.model import Parameters, Sight, elsewhere, evidence

_MOST_VIEWS = 1500
"""Right and wrong ones each: views of one hypothesis say much the same."""
_SPREAD = np.array([1.0, 2.0, 0.5, 0.3, 0.3])


def fit(asked: Sequence[Asked], start: Parameters | None = None) -> Parameters:
    """Parameters of most likelihood.

    Those of what is seen at a place are told by views that are where they are supposed to be, against chance;
    those of the alternatives then by views that are not.

    Args:
        asked: hypotheses, right and wrong ones.
        start: to begin with; the model's own by default.
    """
    start = start or Parameters()
    right, wrong = (_views(asked, false) for false in (False, True))

    def of(x: np.ndarray) -> Parameters:
        offset, angle, zoom, view, surface = x
        return replace(
            start, offset=float(offset), angle=float(max(angle, 0.0)), zoom=float(max(zoom, 0.0)),
            view=float(np.exp(view)), surface=float(np.exp(surface)),
        )  # fmt: skip

    x = np.array([start.offset, start.angle, start.zoom, np.log(start.view), np.log(start.surface)])
    simplex = x + np.vstack([np.zeros(len(x)), np.diag(_SPREAD)])
    found = minimize(
        lambda x: -np.mean([evidence(sight, of(x)).here for sight in right]), x, method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 1e-3, "initial_simplex": simplex},
    )  # fmt: skip
    return fit_alternatives(wrong, of(found.x))


def fit_alternatives(wrong: Sequence[Sight], parameters: Parameters) -> Parameters:
    """γ and the weights of the places that wrong views are of, by their likelihood."""

    def of(x: np.ndarray) -> Parameters:
        part, double = sorted(map(float, expit(x[:2])))
        weights = np.exp(np.append(0.0, x[2:]))
        return replace(
            parameters, part=part, double=double, weights=tuple(map(float, weights / weights.sum()))
        )

    def loss(x: np.ndarray) -> float:
        p = of(x)
        return -float(np.mean([elsewhere(evidence(sight, p), p) for sight in wrong]))

    x = np.array([logit(parameters.part), logit(parameters.double), -1.0, -2.0])
    found = minimize(loss, x, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 1e-3})
    return of(found.x)


def _views(asked: Sequence[Asked], false: bool) -> list[Sight]:
    """Sights of right or of wrong hypotheses, evenly thinned to a number that can be fitted."""
    sights = [sight for one in asked if one.false == false for sight in one.sights if len(sight.point)]
    step = max(len(sights) / _MOST_VIEWS, 1.0)
    return [sights[int(i * step)] for i in range(int(len(sights) / step))]
