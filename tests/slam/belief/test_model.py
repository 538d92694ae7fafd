"""What the model says of a view is as likely as it says, and each of its parts is needed for that."""

from dataclasses import replace

import numpy as np
import pytest
from belief_scenes import GIVEN, seen
from scipy.optimize import minimize_scalar

from dslab.slam.belief.belief import Belief
from dslab.slam.belief.model import WRONG_MAPS, Sight, Unseen, evidence, of_torn, prior


def slope(odds, here):
    """Factor on log-odds (n,) at which they fit what is so best; 1 if they are calibrated."""
    loss = lambda factor: np.logaddexp(0, np.where(here, -1, 1) * factor * odds).mean()  # noqa: E731
    return minimize_scalar(loss, bounds=(0.01, 10), method="bounded").x


def told_of(parameters, n=600, seed=0):
    """(2 n,) evidence of views here and, after them, of strange places; surfaces come and go together."""
    rng, given = np.random.default_rng(seed), replace(GIVEN, surface=2.0)
    alike = np.append(rng.beta(*GIVEN.here, n), np.zeros(n))
    found = [evidence(seen(rng, a, given, most_cells=3), replace(given, **parameters)) for a in alike]
    return found, np.arange(2 * n) < n


def test_against_chance_the_odds_are_calibrated_and_without_surfaces_they_are_not():
    found, here = told_of({})
    assert 0.8 < slope(np.array([e.here for e in found]), here) < 1.25
    alone, here = told_of({"surface": 0.0})
    assert slope(np.array([e.here for e in alone]), here) < 0.7


def test_a_place_alike_is_told_by_its_own_alternative_and_by_chance_it_is_believed():
    rng = np.random.default_rng(0)
    given = replace(GIVEN, alike=(3.0, 0.5))
    alike = np.append(rng.beta(*given.here, 600), rng.beta(*given.alike, 600))
    found, here = [evidence(seen(rng, a), given) for a in alike], np.arange(1200) < 600
    against = np.array([e.ratio for e in found])
    assert 0.8 < slope(against, here) < 1.25
    by_chance = np.array([e.here for e in found])
    assert (by_chance[~here] > 5).mean() > 0.3 > (against[~here] > 5).mean()


def test_a_double_gains_by_all_that_it_shows_as_the_logarithm_only():
    rng = np.random.default_rng(1)
    views = [seen(rng, 1.0) for _ in range(40)]

    def ratio(views):
        together = [np.concatenate([getattr(v, name) for v in views]) for name in Sight._fields[:-1]]
        cell = np.concatenate([v.cell + 100 * i for i, v in enumerate(views)])
        return evidence(Sight(*together, np.zeros(3))._replace(cell=cell), replace(GIVEN, view=0.0)).ratio

    one, ten, forty = ratio(views[:1]), ratio(views[:10]), ratio(views)
    assert one > 1 and forty - ten < 0.5 * GIVEN.alike[1] * np.log(4) + 1
    assert ten - one < 0.5 * GIVEN.alike[1] * np.log(10) + 1


def test_the_farther_a_camera_can_have_come_the_more_places_are_taken_for_the_one():
    near, far = (prior(Unseen(1.0, r, 0.5), GIVEN, "relocalization") for r in (1.0, 100.0))
    assert near - far == pytest.approx(np.log(np.log(10001) / np.log(2)))
    beyond = [near - prior(Unseen(1.0, 1.0, away), GIVEN, "relocalization") for away in (1.1, 1.44, 1e9)]
    assert beyond == pytest.approx([0.0, 10 * np.log(1.2), np.log(100)]), "fast, or carried"
    cut = prior(Unseen(0.03, 0.01, 5.0), GIVEN, "relocalization")
    assert cut > 0, "in no time a camera comes to no double"


def test_a_loop_is_where_the_path_says_but_for_its_drift():
    """And not at once beyond it: a camera that drifted ten times as far is as likely as a cut, no more."""
    odds = [prior(Unseen(20.0, 10.0, away), GIVEN, "loop") for away in (0.0, 0.5, 5.0)]
    assert odds[0] == pytest.approx(-np.log(GIVEN.of_loops))
    assert odds[0] - odds[1] == pytest.approx(1.5 * np.log(2)) and 6 < odds[0] - odds[2] < 8


def test_what_a_loop_tears_is_as_telling_as_it_says_and_a_map_that_was_not_asked_may_still_hold_it():
    rng, shares = np.random.default_rng(0), (GIVEN.torn_here, GIVEN.torn_elsewhere)
    both = np.array([rng.beta(*exponents, 4000) for exponents in shares])
    bent = rng.random(4000) < WRONG_MAPS
    torn = np.where((np.arange(4000) >= 2000) != bent, both[1], both[0])
    odds = np.array([of_torn(share, GIVEN) for share in torn])
    assert slope(odds, np.arange(4000) < 2000) == pytest.approx(1.0, abs=0.1)
    loop = Belief("loop", Unseen(20.0, 10.0, 2.0), parameters=GIVEN)
    loop.add(seen(rng, 1.0))
    alpha = 1 / (1 + np.exp(loop.log_odds + 1.0))
    assert loop.is_beyond(alpha, hoping=True) and not loop.is_beyond(alpha)
    before = loop.log_odds
    loop.tear(0.5)
    assert not loop.is_beyond(alpha, hoping=True) and loop.log_odds < before - 2
    loop.tear(0.0)
    assert loop.is_beyond(alpha) and loop.log_odds > before + 1


def test_a_view_without_points_says_nothing():
    none = Sight(*(np.empty(0, int) for _ in range(2)), *(np.empty(0) for _ in range(5)), np.zeros(3))
    assert np.allclose(evidence(none, GIVEN), 0.0)
