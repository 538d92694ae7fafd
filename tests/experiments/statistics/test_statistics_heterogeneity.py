"""Models of uneven difficulty recover the parameters of a simulation; dose-response and planning."""

import numpy as np
import pytest
import statsmodels.api as sm
from experiment_tables import at_most, within_monte_carlo

from experiments.statistics.dose_response import dose_response
from experiments.statistics.heterogeneity import beta_binomial, beta_factor, eckhardt_lee, mixture
from experiments.statistics.intervals import clopper_pearson
from experiments.statistics.joint import JointCounts, independent
from experiments.statistics.results import DosePoint


def _cell(p0, pr, units, share=None):
    share = pr if share is None else share
    states = np.array([1 - p0, p0 * (1 - share), p0 * share])
    return JointCounts(np.rint(independent(states, np.array([pr])) * units).astype(np.int64))


def test_pooling_easy_and_hard_cells_makes_eq1_optimistic_although_it_holds_in_each():
    found = eckhardt_lee([_cell(0.1, 0.1, 10_000), _cell(0.9, 0.9, 10_000)], 2000, np.random.default_rng(0))
    assert found.within.value == pytest.approx((0.01 + 0.81) / 2, abs=1e-3)
    assert found.pooled.value == pytest.approx(0.25, abs=1e-3)
    assert found.within.low > found.pooled.high
    assert found.measured.low < found.within.value < found.measured.high
    assert eckhardt_lee([_cell(0.1, 0.1, 0)], 10, np.random.default_rng(0)) is None


def test_beta_binomial_finds_its_own_spread():
    rng = np.random.default_rng(1)
    theta = rng.beta(2.0, 6.0, 3000)
    found = beta_binomial("x", rng.binomial(20, theta), np.full(3000, 20))
    assert (found.alpha, found.beta) == pytest.approx((2, 6), rel=0.12)
    # Var / mean² of Beta(2, 6): b / (a (a + b + 1)).
    assert found.var_over_mean2 == pytest.approx(6 / (2 * 9), rel=0.1)
    assert found.p < 1e-6


def test_beta_binomial_has_its_size_if_difficulty_is_even():
    rng = np.random.default_rng(2)
    p = [beta_binomial("x", rng.binomial(40, 0.3, 9), np.full(9, 40)).p for _ in range(150)]
    assert at_most(np.mean(np.array(p) <= 0.05), 0.05, 150)


@pytest.mark.parametrize(
    ("events", "units"),
    [([], []), ([0], [0]), ([3], [9]), ([0, 0], [5, 5]), ([5, 5], [5, 5]), ([9, 0], [9, 9])],
)
def test_beta_binomial_accepts_counts_with_little_information(events, units):
    found = beta_binomial("x", np.array(events), np.array(units))
    assert found.var_over_mean2 is None or np.isfinite(found.var_over_mean2)


@pytest.mark.parametrize("beta", [0.0, 0.15, 0.6])
def test_beta_factor_is_recovered(beta):
    cells = {}
    for p in (0.2, 0.35, 0.5):
        failing = beta * p + (1 - beta) ** 2 * p**2
        cells[str(p)] = _cell(p, p, 20_000, share=failing / p)
    found = beta_factor(cells)
    assert found.beta.value == pytest.approx(beta, abs=0.02)
    assert found.beta.low - 1e-3 <= beta <= found.beta.high
    assert found.predicted["0.5"] == pytest.approx(beta * 0.5 + (1 - beta) ** 2 * 0.25, abs=0.01)
    assert beta_factor({"a": _cell(0.2, 0.2, 0)}) is None


def test_mixture_is_recovered_and_covers():
    rng, held = np.random.default_rng(3), []
    for _ in range(60):
        hopeless = rng.random(150) < 0.2
        failed = np.where(hopeless, 2, rng.binomial(2, 0.15, 150))
        found = mixture(failed.tolist(), 2, 200, rng)
        held.append(
            (
                found.share_hopeless.low <= 0.2 <= found.share_hopeless.high,
                found.pr_rest.low <= 0.15 <= found.pr_rest.high,
            )
        )
    assert np.all(np.mean(held, axis=0) >= 0.95 - 0.015 - 3 * np.sqrt(0.05 * 0.95 / 60))
    large = mixture(np.where(rng.random(50_000) < 0.2, 3, rng.binomial(3, 0.4, 50_000)).tolist(), 3, 100, rng)
    assert (large.share_hopeless.value, large.pr_rest.value) == pytest.approx((0.2, 0.4), abs=0.02)


def test_mixture_needs_two_threads_and_a_breakage():
    rng = np.random.default_rng(0)
    assert mixture([1, 0], 1, 10, rng) is None
    assert mixture([], 2, 10, rng) is None
    # Where every thread fails every time, the classes cannot be told apart.
    assert mixture([2, 2, 2], 2, 10, rng).pr_rest.value is None
    for failed in ([0, 0], [2, 2, 1], [1]):
        found = mixture(failed, 2, 50, rng)
        assert np.isfinite([found.share_hopeless.value, found.pr_rest.value]).all()


def _points(severities, events, units):
    return [DosePoint(s, clopper_pearson(k, units)) for s, k in zip(severities, events, strict=True)]


def test_dose_response_is_the_logistic_regression_in_large_samples():
    severities, units = np.array([1.0, 2, 3, 4]), 4000
    p = 1 / (1 + np.exp(-(-3 + 1.2 * severities)))
    events = np.random.default_rng(4).binomial(units, p)
    found = dose_response("blur", "p0", _points(severities, events, units))
    oracle = sm.GLM(
        np.column_stack([events, units - events]), sm.add_constant(severities), sm.families.Binomial()
    ).fit()
    assert (found.intercept.value, found.slope.value) == pytest.approx(oracle.params, abs=0.01)
    assert (found.slope.low, found.slope.high) == pytest.approx(oracle.conf_int()[1], abs=0.01)
    assert found.ed50.low < 2.5 < found.ed50.high
    _, value, low, high = found.curve[20]
    assert low < value < high and value == pytest.approx(0.5, abs=0.03)


def test_dose_response_covers_as_stated_with_three_severities_of_forty():
    severities = np.array([1.0, 2, 3])
    p = 1 / (1 + np.exp(-(-2.4 + 1.2 * severities)))
    rng, held = np.random.default_rng(5), []
    for _ in range(50):
        found = dose_response("blur", "p0", _points(severities, rng.binomial(40, p), 40))
        ed50, middle = found.ed50, found.curve[20]
        held.append(
            (
                found.slope.low <= 1.2 <= found.slope.high,
                ed50.low is None or ed50.low <= 2 <= ed50.high,
                middle[2] <= 0.5 <= middle[3],
            )
        )
    shares = np.mean(held, axis=0)
    assert all(within_monte_carlo(s, 0.95, 50) for s in shares), shares


def test_separated_severities_give_a_finite_curve_and_a_wide_interval():
    found = dose_response("blur", "p0", _points([1.0, 2.0, 3.0], [0, 0, 20], 20))
    assert 2 < found.ed50.value < 3
    assert 1.5 < found.ed50.low < found.ed50.high < 3.5
    assert 0 < found.slope.low < found.slope.value < found.slope.high < np.inf
    falling = dose_response("contrast", "p0", _points([1.0, 2.0, 3.0], [20, 0, 0], 20))
    assert falling.slope.value == pytest.approx(-found.slope.value, rel=1e-3)


def test_the_severity_of_half_has_no_bounds_if_nothing_rises():
    for events in ([5, 5, 5], [0, 0, 0], [20, 20, 20]):
        found = dose_response("blur", "p0", _points([1.0, 2.0, 3.0], events, 20))
        assert (found.ed50.low, found.ed50.high) == (None, None)
    assert dose_response("blur", "p0", _points([1.0], [5], 20)).slope.value is None
    assert dose_response("blur", "p0", []).curve == ()
