"""What a view says of a supposed place: the likelihood of what it shows there, here and elsewhere.

A point that the view should show is seen with the chance

    logit p = ω logit r + b - f + (σ + ρ_f f) v + τ z,    f = a θ + c √ζ⁺ + d ζ⁻,

with the rate r at which it was found so far, which says less of what comes (ω < 1), and the change θ, ζ of
the direction and of the logarithm of the distance since it was seen from nearest: what has come nearer is
found as before, what has gone farther is soon smaller than what is extracted. v is the view's own, standard
normal: a smeared view shows less of
everything, and how much is lost by seeing from elsewhere differs from place to place. z is the cell's own,
standard normal: points of one surface come and go together. With the likelihood ratio g
of the keypoints that are at its place, it is 1 - p + p g times as likely as by chance. z and v are integrated
over evenly spaced nodes.

The alternative is not chance alone. A place that is taken for this one looks as it does in some share γ of
its surfaces: hardly any in a strange place, half of them where a part repeats itself, nearly all in a room
furnished alike. Nobody knows which, so γ is of a Beta distribution. So it is here, where most surfaces are
as they were and some are covered, or have gone. Over the surfaces c

    L(γ) = Π_c [γ L_c + 1 - γ],  L_here = ∫ L(γ) h(γ) dγ,  L_elsewhere = ∫ L(γ) e(γ) dγ.

v is integrated for each γ on its own: what is missing in some cells and not in others is no smeared view.

However many surfaces a double shows as they should be, it gains by them as their logarithm only: each tells
less of what is not known yet, whether it is a double. But no double is one for ever. Views from elsewhere
see other sides of it, so γ is that of the part of the path before with the chance κ, and another one else.

Before any view, a supposed place is right with the odds 1 : ρ log(1 + r²), r how far the camera has usually
come in the time that it was unseen, in median depths: it has come as likely one to two as two to four of
them, and the more places it passes the more are taken for this one. Any place within r is as likely. Beyond,
few cameras are so much faster, and at last the recording was cut or the camera carried, which is rare but
takes no time: right after the loss nothing else can have led to a double. The camera of a loop was seen all
the way, r: where the loop is right, it is where its path says but for what it drifted, of Student's
distribution and in the middle δ r; elsewhere it is anywhere.

A loop's correction bends the map. Where the loop is right, drift is spread over so many keyframes that hardly
any observation stops fitting; else many do. The share of those that do is of one Beta distribution if it is
right, and of another one if it is not; no residual speaks for itself, as they are torn together. In a map
that something false has bent already it is the other way round.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import betaln, expit, log_expit, log_softmax, logit, logsumexp

_V = np.linspace(-2.5, 2.5, 11)
_Z = np.linspace(-3.0, 3.0, 9)
_LOG_Z = log_softmax(-0.5 * _Z**2)
"""Of nodes of z. With 50 points in a cell the sum is off by .04; five nodes of Gauss and Hermite by .5."""
_FINE = np.linspace(-2.5, 2.5, 101)
_LOG_FINE = log_softmax(-0.5 * _FINE**2)
_BETWEEN = CubicSpline(_V, np.eye(len(_V)))(_FINE)
"""(101, 11): a thousand points tell v so well that logarithms are interpolated between its nodes. With .5
between these in logits the integral is off by .01; five nodes of Gauss and Hermite are by 20."""
_SHARE = np.linspace(-5.0, 8.0, 14)  # logit γ
SHARES = len(_SHARE)
_CUT = np.log(0.01)
"""Of losses of a camera, those by a cut of the recording or by hands that carry it."""
_TAIL = 10.0
"""Exponent of how rarely a camera comes farther than it usually does: of 523 right places none is beyond."""
_APART = 0.2
"""Median depths within which two positions are one place."""
_LEAST = 0.1
"""Of r: a camera that stays may have turned, and sees what it has not seen."""
_LEAST_TORN = 1e-3
"""Share of observations: less is told as this is."""
WRONG_MAPS = 0.05
"""Share of maps that something false has bent already: one of 39 at α = .01, more where more is asked."""
_SUREST = 20.0
"""Logit of a chance that is 1 in double precision soon after, where what is not seen would be impossible."""


@dataclass(frozen=True)
class Parameters:
    """Of the model, as ``dslab belief fit`` finds them.

    Attributes:
        rate: ω.
        offset: b.
        angle: a, per rad.
        farther: c, per root of a doubling of the distance.
        nearer: d, per halving of it.
        view: σ.
        fall: ρ_f.
        surface: τ.
        here, alike: both exponents of the Beta distribution of γ, here and elsewhere.
        lasting: κ.
        doubles: ρ.
        of_loops: odds that a loop without any drift is none.
        of_joins: how much less likely a join is right than a relocalization, before any view.
        drift: δ.
        torn_here, torn_elsewhere: both exponents of the Beta distribution of the share of observations that a
            loop's correction tears, where the loop is right and where it is not.
    """

    rate: float = 1.0
    offset: float = 0.0
    angle: float = 4.0
    farther: float = 2.0
    nearer: float = 0.5
    view: float = 0.4
    fall: float = 0.3
    surface: float = 1.0
    here: tuple[float, float] = (30.0, 0.5)
    alike: tuple[float, float] = (0.5, 0.5)
    lasting: float = 0.6
    doubles: float = 0.3
    of_loops: float = 1.0
    drift: float = 0.05
    of_joins: float = 1.0
    torn_here: tuple[float, float] = (0.5, 20.0)
    torn_elsewhere: tuple[float, float] = (1.0, 2.0)


class Sight(NamedTuple):
    """What a view should show at a supposed place, and what it shows: n points.

    Attributes:
        point: (n,) rows of the map.
        cell: (n,) of the image.
        shown: (n,) g, how much likelier the keypoints at its place are if one of them shows the point.
        found, visible: (n,) frames so far in which the point was found, and should have been.
        angle, zoom: (n,) θ, rad, and ζ.
        centre: (3,) of the camera, median depths of the place.
    """

    point: np.ndarray
    cell: np.ndarray
    shown: np.ndarray
    found: np.ndarray
    visible: np.ndarray
    angle: np.ndarray
    zoom: np.ndarray
    centre: np.ndarray


class Unseen(NamedTuple):
    """A motion that nobody has seen, at the end of which a camera is supposed at a place.

    Attributes:
        since_s: its time; of a loop, since the place was last seen.
        radius: how far the camera usually comes in this time, median depths of the place; NaN if unknown.
            Of a loop, the length of its path.
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
    farther, nearer = np.sqrt(np.maximum(sight.zoom, 0.0)), np.maximum(-sight.zoom, 0.0)
    fall = parameters.angle * sight.angle + parameters.farther * farther + parameters.nearer * nearer
    usual = parameters.rate * logit(rate) + parameters.offset - fall
    of_view = (parameters.view + parameters.fall * fall) * _V[:, None, None]
    p = expit(np.minimum(usual + of_view + parameters.surface * _Z[None, :, None], _SUREST))
    return np.log1p(p * (sight.shown - 1.0))


def by_share(sight: Sight, parameters: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """What each surface of a view says.

    Returns:
        (G, V, g) logarithms of γ L_c + 1 - γ for every share γ and node of v, z integrated; and (n,) the
        surface of each point.
    """
    cells, group = np.unique(sight.cell, return_inverse=True)
    order = np.argsort(group, kind="stable")
    begins = np.searchsorted(group[order], np.arange(len(cells)))
    sums = np.add.reduceat(told(sight, parameters)[..., order], begins, axis=2)
    of_cell = logsumexp(sums + _LOG_Z[:, None], axis=1)
    share = _SHARE[:, None, None]
    return np.logaddexp(log_expit(share) + of_cell, log_expit(-share)), group


def evidence_of(of_parts: np.ndarray, parameters: Parameters) -> Evidence:
    """Of the logarithms (K, G) of L(γ) by the parts of a path, in order."""
    here, elsewhere = (
        over_parts(of_parts, beta, parameters.lasting) for beta in (parameters.here, parameters.alike)
    )
    return Evidence(float(here), float(elsewhere))


def over_parts(of_parts: np.ndarray, exponents: tuple[float, float], lasting: float) -> np.ndarray:
    """Logarithm of the integral over all shares γ, each lasting from part to part with a chance.

    Args:
        of_parts: (..., K, G) logarithms of L(γ); parts of zeros at the end say nothing.
        exponents: of the Beta distribution of γ.
        lasting: κ.
    """
    log_prior = log_prior_of_share(exponents)
    told = log_prior + of_parts[..., 0, :]
    for k in range(1, of_parts.shape[-2]):
        other = log_prior + np.asarray(logsumexp(told, axis=-1, keepdims=True))
        told = np.logaddexp(np.log(lasting) + told, np.log1p(-lasting) + other) + of_parts[..., k, :]
    return np.asarray(logsumexp(told, axis=-1))


def log_prior_of_share(exponents: tuple[float, float]) -> np.ndarray:
    """(G,) logarithms of the chances of each share γ by a Beta distribution."""
    log_density = exponents[0] * log_expit(_SHARE) + exponents[1] * log_expit(-_SHARE)
    return np.asarray(log_density - logsumexp(log_density))


def over_views(of_share: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Integrate v.

    Args:
        of_share: (G, V) logarithms of L(γ) at the nodes of v.

    Returns:
        (G,) logarithms of the integrals; (G, V) weights of the nodes that give a mean over the posterior of
        v; and (G,) the divergence of that from the prior.
    """
    fine = of_share @ _BETWEEN.T + _LOG_FINE
    integral = np.asarray(logsumexp(fine, axis=1))
    log_posterior = fine - integral[:, None]
    posterior = np.exp(log_posterior)
    return integral, posterior @ _BETWEEN, (posterior * (log_posterior - _LOG_FINE)).sum(axis=1)


def evidence(sight: Sight, parameters: Parameters) -> Evidence:
    """What one view says; one that should show nothing says nothing."""
    if not len(sight.point):
        return Evidence(0.0, 0.0)
    return evidence_of(over_views(by_share(sight, parameters)[0].sum(axis=2))[0][None], parameters)


def prior(unseen: Unseen, parameters: Parameters, kind: str) -> float:
    """Log-odds of a supposed place, ``relocalization``, ``loop`` or ``join``, before any view of it."""
    r = unseen.radius if np.isfinite(unseen.radius) else 0.0
    if kind == "loop":
        drifted = unseen.away / max(parameters.drift * r, 1e-9)
        return -float(np.log(parameters.of_loops * (1 + drifted**2) ** 1.5))
    of_kind = parameters.of_joins if kind == "join" else 1.0
    return come(unseen) - float(np.log(of_kind * parameters.doubles * np.log1p(max(r, _LEAST) ** 2)))


def come(unseen: Unseen) -> float:
    """Logarithm of how likely a camera has come so far, over places within its reach; 0 if it is unknown."""
    beyond = unseen.away / (unseen.radius + _APART)
    return max(-_TAIL * float(np.log(beyond)), float(_CUT)) if beyond > 1.0 else 0.0


def log_density_of_torn(shares: float | np.ndarray, exponents: tuple[float, float]) -> np.ndarray:
    """(n,) logarithms of the Beta density of shares (n,)."""
    x, (a, b) = np.clip(shares, _LEAST_TORN, 1 - _LEAST_TORN), exponents
    return np.asarray((a - 1) * np.log(x) + (b - 1) * np.log1p(-x) - betaln(a, b))


def of_torn(share: float, parameters: Parameters) -> float:
    """Logarithm of how much likelier a right loop's correction tears a share than a wrong one's."""
    here, elsewhere = (
        float(log_density_of_torn(share, exponents))
        for exponents in (parameters.torn_here, parameters.torn_elsewhere)
    )
    sound, wrong = np.log1p(-WRONG_MAPS), np.log(WRONG_MAPS)
    return float(
        np.logaddexp(sound + here, wrong + elsewhere) - np.logaddexp(sound + elsewhere, wrong + here)
    )
