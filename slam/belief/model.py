"""What a view says of a supposed place: the likelihood of what it shows there, here and elsewhere.

A point that the view should show is seen with the chance

    logit p = logit r + b - a θ - c |ζ| + v + τ z,

with the rate r at which it was found so far, and the change θ, ζ of the direction and of the logarithm of the
distance since it was seen from nearest. v is the view's own, normal: a smeared view shows less of everything.
z is the cell's own, standard normal: points of one surface come and go together. With the likelihood ratio g
of the keypoints that are at its place, it is 1 - p + p g times as likely as by chance. z and v are integrated
by Gauss and Hermite.

The alternative is not chance alone. Elsewhere a cell may look as it does here, with the chance γ: 0 in a
strange place, .5 where a part repeats itself, .95 in a room furnished alike. Over the cells c

    L = Π_c [γ L_here(c) + 1 - γ].
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import expit, logit, logsumexp

_NODES = 5
_AT, _WEIGHT = np.polynomial.hermite_e.hermegauss(_NODES)
LOG_WEIGHT = np.log(_WEIGHT / _WEIGHT.sum())
"""(5,) of the nodes of v and of z, logarithms."""


@dataclass(frozen=True)
class Parameters:
    """Of the model, as ``dslab belief fit`` finds them.

    Attributes:
        offset: b.
        angle: a, per rad.
        zoom: c, per doubling of the distance.
        view: standard deviation of v.
        surface: τ.
        part, double: γ of a place that repeats a part of this one, and of one that is furnished alike.
        weights: chances of a strange place, of such a part and of a double, where the view is not here.
    """

    offset: float = 0.0
    angle: float = 4.0
    zoom: float = 1.0
    view: float = 1.0
    surface: float = 1.0
    part: float = 0.5
    double: float = 0.95
    weights: tuple[float, float, float] = (0.8, 0.15, 0.05)


class Sight(NamedTuple):
    """What a view should show at a supposed place, and what it shows: n points.

    Attributes:
        point: (n,) rows of the map.
        cell: (n,) of the image.
        shown: (n,) g, how much likelier the keypoints at its place are if one of them shows the point.
        found, visible: (n,) frames so far in which the point was found, and should have been.
        angle, zoom: (n,) θ, rad, and ζ.
    """

    point: np.ndarray
    cell: np.ndarray
    shown: np.ndarray
    found: np.ndarray
    visible: np.ndarray
    angle: np.ndarray
    zoom: np.ndarray


class Evidence(NamedTuple):
    """Logarithms of likelihoods over that of chance: of here, of a place alike in part, of a double."""

    here: float
    part: float
    double: float


def told(sight: Sight, parameters: Parameters) -> np.ndarray:
    """(V, K, n) logarithms of the ratios of each point, by the nodes of v and of z."""
    rate = (sight.found + 1.0) / (sight.visible + 2.0)
    usual = logit(rate) + parameters.offset
    usual -= parameters.angle * sight.angle + parameters.zoom * np.abs(sight.zoom)
    p = expit(usual + parameters.view * _AT[:, None, None] + parameters.surface * _AT[None, :, None])
    return np.log1p(p * (sight.shown - 1.0))


def evidence_of(ratios: np.ndarray, group: np.ndarray, parameters: Parameters) -> Evidence:
    """Of points whose surfaces are named.

    Args:
        ratios: (V, K, n) as of :func:`told`, or (1, K, n) where v is known.
        group: (n,) the surface of each.
        parameters: of the model.
    """
    return evidence_of_cells(by_surface(ratios, group), parameters)


def evidence_of_cells(of_cell: np.ndarray, parameters: Parameters) -> Evidence:
    """Of the log-ratios (V, g) of surfaces, as of :func:`by_surface`."""
    of_view = LOG_WEIGHT if len(of_cell) > 1 else np.zeros(1)

    def all_cells(alike: float) -> float:
        each = of_cell if alike == 1 else np.logaddexp(np.log(alike) + of_cell, np.log1p(-alike))
        return float(logsumexp(each.sum(axis=1) + of_view))

    return Evidence(all_cells(1.0), all_cells(parameters.part), all_cells(parameters.double))


def by_surface(ratios: np.ndarray, group: np.ndarray) -> np.ndarray:
    """(V, g) of each surface, z integrated, of ratios (V, K, n) and the surface (n,) of each."""
    if not len(group):
        return np.zeros((len(ratios), 0))
    group = np.asarray(group, np.int64)
    order = np.argsort(group, kind="stable")
    begins = np.flatnonzero(np.diff(group[order], prepend=group[order[0]] - 1))
    sums = np.add.reduceat(ratios[..., order], begins, axis=2)
    return np.asarray(logsumexp(sums + LOG_WEIGHT[:, None], axis=1))


def evidence(sight: Sight, parameters: Parameters) -> Evidence:
    """What one view says."""
    return evidence_of(told(sight, parameters), sight.cell, parameters)


def elsewhere(said: Evidence, parameters: Parameters) -> float:
    """Logarithm of the likelihood that the view is not here, over that of chance."""
    strange, part, double = np.log(parameters.weights)
    return float(logsumexp([strange, part + said.part, double + said.double]))
