"""Every point speaks once, and one view says by the ledger what it says by the model."""

import numpy as np
import pytest
from belief_scenes import GIVEN, seen

from dslab.slam.belief.ledger import Ledger
from dslab.slam.belief.model import evidence


def ledger_of(*sights):
    return Ledger(GIVEN, sights)


def views(n=1, seed=3, alike=1.0):
    rng = np.random.default_rng(seed)
    return [seen(rng, alike) for _ in range(n)]


def test_one_view_says_what_the_model_says_and_ten_times_the_same_no_more():
    (view,) = views()
    assert ledger_of(view).evidence() == pytest.approx(evidence(view, GIVEN), abs=0.05)
    assert ledger_of(*[view] * 10).evidence() == pytest.approx(ledger_of(view).evidence())


def test_other_points_say_more_and_a_covered_view_is_not_held_against_a_place_for_ever():
    one, *others = views(6)
    apart = [s._replace(point=s.point + 1000 * i) for i, s in enumerate(others, 1)]
    assert ledger_of(one, *apart).evidence().here > 3 * ledger_of(one).evidence().here
    covered = one._replace(shown=np.zeros(len(one.point)))
    assert ledger_of(covered).evidence().here < 0
    assert ledger_of(covered, *[one] * 5).evidence().here > 0.5 * ledger_of(one).evidence().here


def test_surfaces_that_come_and_go_are_those_of_a_place_alike():
    """As a mean by points before surfaces are weighed they would be believed: none is missing always."""
    rng, shown = np.random.default_rng(5), []
    (view,) = views(1, seed=4)
    for _ in range(20):
        there = rng.random(view.cell.max() + 1) < 0.6
        shown.append(view._replace(shown=np.where(there[view.cell], view.shown, 0.0)))
    assert ledger_of(view).evidence().ratio > 1
    assert ledger_of(*shown).evidence().ratio < np.max([evidence(s, GIVEN).ratio for s in shown])
    assert ledger_of(*shown).evidence().ratio < -2


def test_from_elsewhere_the_same_points_are_asked_anew_and_a_double_seldom_lasts():
    (view,) = views(1, seed=6)
    moved = [view._replace(centre=np.array([x, 0.0, 0.0])) for x in np.arange(0, 3, 0.3)]
    still = [view._replace(centre=np.array([x, 0.0, 0.0])) for x in np.arange(0, 0.1, 0.01)]
    one, on, there = (ledger_of(*s).evidence().ratio for s in ([view], moved, still))
    assert there == pytest.approx(one) and on > one + 2
    # And back where it was it says no more.
    assert ledger_of(*moved, *moved).evidence().ratio == pytest.approx(on)


def test_a_view_that_should_show_nothing_says_nothing():
    (view,) = views()
    nothing = view._replace(**{name: getattr(view, name)[:0] for name in view._fields[:-1]})
    ledger = ledger_of(nothing)
    assert ledger.views == 0 and tuple(ledger.evidence()) == pytest.approx((0.0, 0.0))
