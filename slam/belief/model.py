"""What a view says of a supposed place: the likelihood of what it shows there, here and elsewhere.

A point that the view should show is seen with the chance

    logit p = logit r + b - a θ - c |ζ| + v + τ z,

with the rate r at which it was found so far, and the change θ, ζ of the direction and of the logarithm of the
distance since it was seen from nearest. v is the view's own, normal: a smeared view shows less of everything.
z is the cell's own, standard normal: points of one surface come and go together. With the likelihood ratio g
of the keypoints that are at its place, it is 1 - p + p g times as likely as by chance. z and v are integrated
by Gauss and Hermite.

The alternative is not chance alone. A place that is taken for this one looks as it does in some share γ of
its surfaces: hardly any in a strange place, half of them where a part repeats itself, nearly all in a room
furnished alike. Nobody knows which, so γ is of a Beta distribution, and over the surfaces c

    L_elsewhere = ∫ Π_c [γ L_here(c) + 1 - γ] p(γ) dγ.

However many surfaces a double shows as they should be, it gains by them as their logarithm only: each tells
less of what is not known yet, whether it is a double.

Before any view, a supposed place is right with the odds 1 : ρ_0 + ρ r², r how far the camera can have come
unseen, in median depths: so many places may be taken for it. Beyond r the recording was cut, or the camera
carried, with the odds κ.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import expit, log_expit, logit, logsumexp

_NODES = 5
_AT, _WEIGHT = np.polynomial.hermite_e.hermegauss(_NODES)
LOG_WEIGHT = np.log(_WEIGHT / _WEIGHT.sum())
"""(5,) of the nodes of v and of z, logarithms."""
_SHARE = np.linspace(-6.0, 9.0, 31)  # logit γ
_LOG_ALIKE, _LOG_OTHER = log_expit(_SHARE), log_expit(-_SHARE)
_CUT = np.log(1e-3)


@dataclass(frozen=True)
class Parameters:
    """Of the model, as ``dslab belief fit`` finds them.

    Attributes:
        offset: b.
        angle: a, per rad.
        zoom: c, per doubling of the distance.
        view: standard deviation of v.
        surface: τ.
        alike: both exponents of the Beta distribution of γ.
        at_once, per_area: ρ_0 and ρ.
        of_loops: ρ_0 + ρ r² of a loop, whose camera was seen all the way.
    """

    offset: float = 0.0
    angle: float = 4.0
    zoom: float = 1.0
    view: float = 1.0
    surface: float = 1.0
    alike: tuple[float, float] = (0.5, 0.5)
    at_once: float = 0.1
    per_area: float = 0.1
    of_loops: float = 1.0


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


class Unseen(NamedTuple):
    """A motion that nobody has seen, at the end of which a camera is supposed at a place.

    Attributes:
        since_s: its time; of a loop, since the place was last seen.
        radius: how far the camera can have come in this time, median depths of the place; NaN if unknown.
        away: how far it would have come, median depths.
    """

    since_s: float
    radius: float = np.nan
    away: float = np.nan


class Evidence(NamedTuple):
    """Logarithms of likelihoods over that of chance: of here, and of a place that is taken for it."""

    here: float
    elsewhere: float

    @property
    def ratio(self) -> float:
        """Logarithm of the likelihood of here over elsewhere."""
        return self.here - self.elsewhere


def told(sight: Sight, parameters: Parameters) -> np.ndarray:
    """(V, K, n) logarithms of the ratios of each point, by the nodes of v and of z."""
    rate = (sight.found + 1.0) / (sight.visible + 2.0)
    usual = logit(rate) + parameters.offset
    usual -= parameters.angle * sight.angle + parameters.zoom * np.abs(sight.zoom)
    p = expit(usual + parameters.view * _AT[:, None, None] + parameters.surface * _AT[None, :, None])
    return np.log1p(p * (sight.shown - 1.0))


def evidence_of_cells(of_cell: np.ndarray, parameters: Parameters) -> Evidence:
    """Of the log-ratios (V, g) of surfaces, as of :func:`by_surface`."""
    of_view = LOG_WEIGHT if len(of_cell) > 1 else np.zeros(1)
    here = float(logsumexp(of_cell.sum(axis=1) + of_view))
    of_share = logsumexp(by_share(of_cell) + of_view, axis=1)
    return Evidence(here, float(logsumexp(of_share + log_prior_of_share(parameters))))


def by_share(of_cell: np.ndarray) -> np.ndarray:
    """(G, V) of each share γ of surfaces that are alike, of log-ratios (V, g)."""
    alike, other = _LOG_ALIKE[:, None, None], _LOG_OTHER[:, None, None]
    return np.asarray(np.logaddexp(alike + of_cell, other).sum(axis=2))


def log_prior_of_share(parameters: Parameters) -> np.ndarray:
    """(G,) logarithms of the chances of each share γ."""
    a, b = parameters.alike
    log_density = a * _LOG_ALIKE + b * _LOG_OTHER
    return np.asarray(log_density - logsumexp(log_density))


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
    return evidence_of_cells(by_surface(told(sight, parameters), sight.cell), parameters)


def prior(unseen: Unseen, parameters: Parameters, is_loop: bool) -> float:
    """Log-odds of a supposed place before any view of it."""
    if is_loop:
        return -float(np.log(parameters.of_loops))
    r = unseen.radius if np.isfinite(unseen.radius) else 0.0
    odds = -float(np.log(parameters.at_once + parameters.per_area * r * r))
    return odds + _CUT if unseen.away > unseen.radius else odds
