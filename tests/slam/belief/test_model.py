"""What the model says of a view is as likely as it says, and each of its parts is needed for that."""

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import expit, logit

from dslab.slam.belief.model import Parameters, Sight, evidence

GIVEN = Parameters()
APART = 3.0  # of the keypoints that show a point, and of those that do not, in deviations


def seen(rng, alike):
    """A view of a place in which the share ``alike`` of the cells is as the map has it."""
    cells = rng.integers(4, 14)
    cell = np.repeat(np.arange(cells), rng.integers(2, 12, cells))
    n = len(cell)
    visible = rng.integers(3, 40, n).astype(float)
    found = rng.binomial(visible.astype(int), rng.beta(6, 3, n)).astype(float)
    angle, zoom = rng.gamma(1.5, 0.05, n), rng.normal(0, 0.3, n)
    usual = logit((found + 1) / (visible + 2)) + GIVEN.offset - GIVEN.angle * angle
    usual -= GIVEN.zoom * np.abs(zoom)
    usual += GIVEN.view * rng.normal() + GIVEN.surface * rng.normal(size=cells)[cell]
    shows = (rng.random(n) < expit(usual)) & (rng.random(cells) < alike)[cell]
    x = rng.normal(APART * shows, 1.0)
    return Sight(np.arange(n), cell, np.exp(APART * x - APART**2 / 2), found, visible, angle, zoom)


def slope(odds, here):
    """Factor on log-odds (n,) at which they fit what is so best; 1 if they are calibrated."""
    loss = lambda factor: np.logaddexp(0, np.where(here, -1, 1) * factor * odds).mean()  # noqa: E731
    return minimize_scalar(loss, bounds=(0.01, 10), method="bounded").x


def told_of(alike, parameters, n=600, seed=0):
    """(2 n,) evidence of views here and, after them, of places alike, with the share of cells that is so."""
    rng = np.random.default_rng(seed)
    return [evidence(seen(rng, a), parameters) for a in [1.0] * n + [alike] * n], np.arange(2 * n) < n


def test_against_chance_the_odds_are_calibrated_and_without_surfaces_they_are_not():
    found, here = told_of(0.0, GIVEN)
    assert 0.8 < slope(np.array([e.here for e in found]), here) < 1.25
    alone, here = told_of(0.0, replace(GIVEN, surface=0.0, view=0.0))
    assert slope(np.array([e.here for e in alone]), here) < 0.7


def test_a_place_alike_is_told_by_its_own_alternative_and_by_chance_it_is_believed():
    for alike, name in ((GIVEN.part, "part"), (GIVEN.double, "double")):
        found, here = told_of(alike, GIVEN)
        against = np.array([e.here - getattr(e, name) for e in found])
        assert 0.8 < slope(against, here) < 1.25
        by_chance = np.array([e.here for e in found])
        assert (by_chance[~here] > 5).mean() > 0.3 > (against[~here] > 5).mean()


def test_a_view_without_points_says_nothing():
    none = Sight(*(np.empty(0, int) for _ in range(2)), *(np.empty(0) for _ in range(5)))
    assert np.allclose(evidence(none, GIVEN), 0.0)
