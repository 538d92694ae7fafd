"""The boundary search: curves, posterior, choice of doses and answer, against what is known and twins."""

from itertools import product
from math import inf, log

import numpy as np
import pytest
from scipy.stats import norm

from dslab.experiments.statistics.boundary import MOST_AT_ONCE, SHAM, CurveGrid, Curves, curve_grid, quantile
from dslab.experiments.statistics.boundary_proofs import STRENGTHS, answer, search

GRID = curve_grid(STRENGTHS)
TRIALS = [SHAM, SHAM, 9, 9, 14, 5, 11, 12, 19], [False, True, False, True, True, False, False, True, True]


def entropy(probabilities):
    return -sum(p * log(p) for p in np.ravel(probabilities) if p > 0)


def test_curves_rise_from_the_sham_rate_to_the_ceiling_and_pass_their_middle_half_way():
    far = 60.0
    assert GRID.failure(-far) == pytest.approx(GRID.sham_rates)
    assert GRID.failure(far) == pytest.approx(GRID.ceilings)
    at = np.flatnonzero((GRID.slopes > 2) & (GRID.ceilings == 0.9) & (GRID.sham_rates == 0.1))[7]
    middle = GRID.middles[at]
    assert GRID.failure(middle)[at] == pytest.approx(0.5)
    # The slope is that of the logit: a step of 1 / s takes the rise from 1/2 to 1 / (1 + 1/e).
    assert GRID.failure(middle + 1 / GRID.slopes[at])[at] == pytest.approx(0.1 + 0.8 / (1 + np.exp(-1)))


def test_the_posterior_is_the_product_of_the_likelihoods_in_any_order_of_trials():
    slow = np.ones(len(GRID.middles))
    for place, failed in zip(*TRIALS, strict=True):
        p = GRID.failure(-1e3 if place == SHAM else STRENGTHS[place])
        slow *= p if failed else 1 - p
    found = GRID.posterior(*TRIALS)
    assert found == pytest.approx(slow / slow.sum(), abs=1e-12)
    backwards = GRID.posterior(*(list(reversed(x)) for x in TRIALS))
    assert np.array_equal(found, backwards)
    before = GRID.posterior([], [])
    assert before == pytest.approx(1 / len(before))


@pytest.mark.slow
def test_each_dose_of_a_batch_adds_most_to_what_all_outcomes_tell():
    weights, p = GRID.posterior(*TRIALS), GRID.failure(np.asarray(STRENGTHS))

    def told(places):
        """Mutual information of curve and outcomes, by its definition: over every combination of outcomes."""
        likely = [
            np.prod([p[at] if failed else 1 - p[at] for at, failed in zip(places, all_, strict=True)], axis=0)
            for all_ in product((True, False), repeat=len(places))
        ]
        # What is left of the entropy of the curve after the outcomes, on average.
        left = sum((weights @ one) * entropy(weights * one / (weights @ one)) for one in likely)
        return entropy(weights) - left

    chosen = GRID.choose(weights, 3)
    for number in range(3):
        best = max(told([*chosen[:number], place]) for place in range(len(STRENGTHS)))
        assert told(chosen[: number + 1]) == pytest.approx(best, abs=1e-6)
    assert GRID.choose(weights, MOST_AT_ONCE)[:3] == chosen


def test_a_quantile_may_be_infinite():
    values, weights = np.array([inf, 1.0, 3.0, 2.0]), np.array([0.4, 0.2, 0.2, 0.2])
    assert quantile(values, weights, 0.3) == pytest.approx(2.0)
    assert quantile(values, weights, 0.2) == pytest.approx(1.5)
    assert quantile(values, weights, 0.7) == inf
    assert quantile(-values, weights, 0.1) == -inf
    assert quantile(values, weights, 0.0) == 1.0


def test_the_strength_that_reaches_a_level_is_infinite_for_a_ceiling_or_a_sham_rate_on_the_other_side():
    reaching = GRID.reaching(0.3)
    assert np.all((reaching == -inf) == (GRID.sham_rates >= 0.3))
    finite = np.isfinite(reaching)
    at = np.array([GRID.failure(u)[i] for i, u in enumerate(reaching[:400]) if finite[i]])
    assert at == pytest.approx(0.3)
    assert np.all((GRID.reaching(0.7) == inf) == (GRID.ceilings <= 0.7))


def test_no_failures_at_all_and_nothing_but_failures_are_out_of_the_doses():
    none = GRID.boundary(GRID.posterior(*search(lambda _: False)), 0.5)
    assert none.median > STRENGTHS[-1] and none.high > STRENGTHS[-1] and none.sham_rate < 0.1
    always = GRID.boundary(GRID.posterior(*search(lambda u: u > -inf)), 0.5)
    assert always.median < STRENGTHS[0] and always.unreachable < 0.05


def test_a_failure_without_stress_that_is_as_frequent_leaves_no_dose():
    half = GRID.boundary(GRID.posterior([SHAM] * 200, [i % 5 < 2 for i in range(200)]), 0.3)
    assert half.median == -inf and half.sham_rate == pytest.approx(0.4, abs=0.02)


def test_a_ceiling_below_the_level_is_told_from_a_boundary_that_was_not_found():
    found = answer(Curves(1.5, 3.0, 0.5), 0.7, np.random.default_rng(0))
    assert found.unreachable > 0.5 and found.median == inf and found.high == inf


def test_chosen_doses_tell_more_of_the_boundary_than_evenly_spread_ones():
    planted = Curves(2.6, 8.0)
    chosen, spread = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        found = answer(planted, 0.5, rng)
        chosen.append(found.high - found.low)
        places = [SHAM] * 8 + [i % len(STRENGTHS) for i in range(52)]
        failed = [
            bool(rng.random() < planted.failure(-inf if place == SHAM else STRENGTHS[place])[0])
            for place in places
        ]
        even = GRID.boundary(GRID.posterior(places, failed), 0.5)
        spread.append(even.high - even.low)
    assert np.median(chosen) < 0.7 * np.median(spread)


def test_the_band_of_the_curve_holds_its_median():
    median, low, high = GRID.curve(GRID.posterior(*TRIALS), np.linspace(0, 4, 9))
    assert np.all((low <= median) & (median <= high)) and np.all(np.diff(median) >= 0)


class NormalCurves(CurveGrid):
    """The same with the curves of questplus: a cumulated normal distribution between two asymptotes."""

    def __init__(self, strengths, middles, sds, sham_rates, lapses):
        self.strengths = np.asarray(strengths)
        parameters = np.meshgrid(middles, sds, sham_rates, lapses, indexing="ij")
        self.middles, self.sds, self.sham_rates, self.lapses = (x.ravel() for x in parameters)

    def failure(self, strength):
        u = np.asarray(strength, dtype=float)[..., None]
        span = 1 - self.sham_rates - self.lapses
        return self.sham_rates + span * norm.cdf(u, self.middles, self.sds)


def test_posterior_and_doses_are_those_of_questplus():
    questplus = pytest.importorskip("questplus", exc_type=ImportError)
    strengths, middles, sds = np.linspace(0, 4, 13), np.linspace(-0.5, 4.5, 21), [0.2, 0.5, 1.0]
    sham_rates, lapses = [0.0, 0.1], [0.02, 0.3]
    own = NormalCurves(strengths, middles, sds, sham_rates, lapses)
    other = questplus.QuestPlus(
        stim_domain={"intensity": strengths},
        param_domain={"mean": middles, "sd": sds, "lower_asymptote": sham_rates, "lapse_rate": lapses},
        outcome_domain={"response": ["yes", "no"]},
        func="norm_cdf",
        stim_scale="linear",
        stim_selection_method="min_entropy",
        param_estimation_method="mean",
    )
    rng, places, failed = np.random.default_rng(3), [], []
    for _ in range(25):
        (place,) = own.choose(own.posterior(places, failed), 1)
        assert strengths[place] == other.next_stim["intensity"]
        places.append(place)
        failed.append(bool(rng.random() < norm.cdf(strengths[place], 2.1, 0.4) * 0.9))
        other.update(stim=other.next_stim, outcome={"response": "yes" if failed[-1] else "no"})
    dims = ("mean", "sd", "lower_asymptote", "lapse_rate")
    theirs = other.posterior.transpose(*dims).to_numpy().ravel()
    assert own.posterior(places, failed) == pytest.approx(theirs, abs=1e-9)
