"""Eq. 1 in a cell: coverage, size and power if it holds and if difficulty is shared."""

import numpy as np
import pytest
from experiment_tables import at_most, within_monte_carlo
from scipy.optimize import minimize

from experiments.statistics.eq1 import predicted_and_ratio, predicted_at_free_length, verdict
from experiments.statistics.equivalence import holm, tost
from experiments.statistics.joint import JointCounts, draw_tables, independent, margins_of, patterns, raked
from experiments.statistics.likelihood_ratio import constrained_estimates, eq1_test, signed_root

# Units, p0, pr, n, odds by which a breakage raises each crossing's failure.
PAIRED = [(40, 0.3, 0.3, 1, 1.0), (40, 0.3, 0.3, 2, 6.0), (100, 0.25, 0.2, 1, 4.0), (400, 0.3, 0.4, 2, 3.0)]


def paired_model(p0, pr, n, ratio=1.0, odds=1.0):
    """Joint distribution with these margins: P(D_n) = ratio · p0 · prⁿ, arms paired."""
    seen = np.ones((3, 2**n))
    seen[1:] *= odds ** patterns(n).sum(axis=1)
    share = ratio * pr**n
    return raked(1e9 * seen, np.array([1 - p0, p0 * (1 - share), p0 * share]), np.full(n, pr))


def table_of(p0, pr, n, units, ratio=1.0):
    return JointCounts(np.rint(paired_model(p0, pr, n, ratio) * units).astype(np.int64))


def simulated(case, ratio, replicates, measure):
    units, p0, pr, n, odds = case
    model = paired_model(p0, pr, n, ratio, odds)
    drawn = draw_tables(np.random.default_rng(7), model, units, replicates)
    rng = np.random.default_rng(8)
    return np.array([measure(JointCounts(table), rng) for table in drawn])


def _p(counts, rng, replicates=199):
    found = eq1_test(counts, replicates, rng).p
    return 1.0 if found is None else found


def test_units_are_counted_by_their_joint_outcome():
    breakage = np.array([True, True, False, True])
    failure = np.array([True, False, False, True])
    crossings = np.array([[True, False], [False, True], [False, False], [True, True]])
    table = JointCounts.of_units(breakage, failure, crossings).table
    assert table.tolist() == [[1, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 1]]
    found = margins_of(table[None])
    assert (found.units[0], found.breakages[0], found.failures[0]) == (4, 3, 2)
    assert found.crossings[0].tolist() == [2, 2]


def test_raking_meets_the_margins_and_keeps_the_odds_ratio():
    seen = np.array([[400_000, 100_000], [100_000, 100_000], [50_000, 250_000]])
    found = raked(seen, np.array([0.6, 0.3, 0.1]), np.array([0.35]))
    assert found.sum(axis=1) == pytest.approx([0.6, 0.3, 0.1])
    assert found[:, 1].sum() == pytest.approx(0.35)
    odds = found[2, 1] * found[0, 0] / (found[2, 0] * found[0, 1])
    assert odds == pytest.approx(20.0, rel=1e-3)


@pytest.mark.parametrize("counts", [(60, 20, 9, [14, 11]), (40, 12, 0, [5, 9]), (50, 30, 3, [33, 28])])
@pytest.mark.parametrize("ratio", [1.0, 2.0, 0.5])
def test_constrained_estimates_are_the_maximum(counts, ratio):
    units, breakages, failures, crossings = counts
    batch = margins_of(np.zeros((1, 3, 4)))
    batch = type(batch)(*(np.array([float(x)]) for x in counts[:3]), np.array([crossings], float))
    share, pr = constrained_estimates(batch, ratio)
    assert share[0] == pytest.approx(ratio * pr[0].prod(), abs=1e-9)

    def loss(x):
        p = 1 / (1 + np.exp(-x))
        q = np.clip(ratio * p.prod(), 1e-12, 1 - 1e-12)
        own = failures * np.log(q) + (breakages - failures) * np.log(1 - q)
        return -own - sum(
            k * np.log(r) + (units - k) * np.log(1 - r) for k, r in zip(crossings, p, strict=True)
        )

    best = minimize(loss, np.log(pr[0] / (1 - pr[0])) + 0.3, method="Nelder-Mead", options={"xatol": 1e-9})
    assert 1 / (1 + np.exp(-best.x)) == pytest.approx(pr[0], abs=1e-4)


def test_the_statistic_is_chi_squared_in_large_samples_when_eq1_holds():
    drawn = draw_tables(np.random.default_rng(3), paired_model(0.4, 0.4, 1), 4000, 4000)
    statistic = signed_root(margins_of(drawn)) ** 2
    assert within_monte_carlo(np.mean(statistic > 3.8415), 0.05, 4000)


@pytest.mark.parametrize("case", PAIRED)
def test_predicted_and_ratio_cover_as_stated(case):
    _, p0, pr, n, _ = case
    replicates = 150
    for ratio in (1.0, 2.0):

        def covered(counts, rng, truth=ratio):
            predicted, found = predicted_and_ratio(counts, 300, rng)
            unbounded = found.high is None
            return (
                predicted.low <= p0 * pr**n <= predicted.high,
                (found.low is None or found.low <= truth) and (unbounded or truth <= found.high),
            )

        held = simulated(case, ratio, replicates, covered).mean(axis=0)
        # Discrete counts make the coverage vary by about a point about its average.
        assert np.all(held >= 0.95 - 0.015 - 3 * np.sqrt(0.05 * 0.95 / replicates)), held


@pytest.mark.parametrize("case", PAIRED[:1])
def test_the_size_is_at_most_nominal_if_eq1_holds(case):
    rejected = simulated(case, 1.0, 100, lambda c, rng: _p(c, rng, 99)) <= 0.05
    assert at_most(rejected.mean(), 0.05, 100)


@pytest.mark.slow
@pytest.mark.parametrize("case", [(40, 0.5, 0.2, 1, 3.0)])
def test_the_size_is_at_most_nominal_in_detail(case):
    rejected = simulated(case, 1.0, 600, lambda c, rng: _p(c, rng, 199)) <= 0.05
    assert at_most(rejected.mean(), 0.05, 600)


@pytest.mark.parametrize("case", [PAIRED[0], pytest.param((90, 0.5, 0.35, 1, 2.0), marks=pytest.mark.slow)])
def test_the_stated_power_is_the_share_rejected_and_a_ratio_of_2_is_seldom_called_consistent(case):
    def outcome(counts, rng):
        found = eq1_test(counts, 99, rng)
        power = found.power(0.05)
        given = verdict(found.p, found.measured_above, power, 0.05, 0.8)
        return given == "optimistic", power, given == "consistent"

    optimistic, stated, consistent = simulated(case, 2.0, 150, outcome).mean(axis=0)
    assert abs(stated - optimistic) < 3.5 * np.sqrt(0.25 / 150)
    assert consistent < 0.2


def test_shared_difficulty_is_found_to_be_optimistic():
    table = table_of(0.3, 0.3, 1, 400, ratio=2.2)
    found = eq1_test(table, 999, np.random.default_rng(1))
    assert found.p is not None and found.p < 0.005
    assert found.measured_above
    _, ratio = predicted_and_ratio(table, 2000, np.random.default_rng(1))
    assert ratio.low > 1.4 and ratio.value == pytest.approx(2.2, rel=0.05)


def test_pairing_is_not_ignored():
    # If a recovery fails in exactly the units in which the crossing fails, both shares always agree.
    states, pr = np.array([0.0, 0.7, 0.3]), np.array([0.3])
    agree = raked(np.array([[0, 0], [28_000, 0], [0, 12_000]]), states, pr)
    spread = [
        signed_root(margins_of(draw_tables(np.random.default_rng(0), model, 400, 2000))).std()
        for model in (agree, independent(states, pr))
    ]
    assert spread[0] < 0.1
    assert spread[1] == pytest.approx(1, abs=0.05)


def test_equivalence_has_its_size_at_the_bound_and_confirms_if_eq1_holds():
    case = (300, 0.5, 0.5, 1, 2.0)

    def p(counts, rng):
        return tost(counts, 1.5, 99, rng)

    assert at_most((simulated(case, 1.5, 60, p) <= 0.05).mean(), 0.05, 60)
    assert (simulated(case, 1.0, 20, p) <= 0.05).mean() > 0.8


def test_equivalence_of_too_few_units_is_not_shown():
    assert tost(table_of(0.3, 0.3, 1, 40), 2.0, 499, np.random.default_rng(0)) > 0.05
    with pytest.raises(ValueError):
        tost(table_of(0.3, 0.3, 1, 40), 1.0, 99, np.random.default_rng(0))


def test_holm_multiplies_by_the_remaining_tests_and_ignores_untested_cells():
    found = holm([0.04, None, 0.001, 0.3, 0.02])
    assert found[1] is None
    assert [x for x in found if x is not None] == pytest.approx([2 * 0.04, 4 * 0.001, 0.3, 3 * 0.02])
    assert holm([None]) == [None] and holm([]) == []


def test_an_undecided_cell_is_never_called_consistent():
    assert verdict(0.5, True, 0.79, 0.05, 0.8) == "undecided"
    assert verdict(None, False, 1.0, 0.05, 0.8) == "undecided"
    assert verdict(0.5, True, None, 0.05, 0.8) == "undecided"
    assert verdict(0.5, True, 0.81, 0.05, 0.8) == "consistent"
    assert verdict(0.01, True, 0.2, 0.05, 0.8) == "optimistic"
    assert verdict(0.01, False, 0.9, 0.05, 0.8) == "pessimistic"


@pytest.mark.parametrize(
    "table",
    [
        np.zeros((3, 4)),
        [[9, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]],
        [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 9]],
        [[5, 0, 0, 0], [4, 0, 0, 0], [0, 0, 0, 0]],
        [[5, 0, 0, 0], [0, 0, 0, 0], [4, 0, 0, 0]],
        [[1, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]],
        [[0, 0, 0, 9], [0, 0, 0, 0], [0, 0, 0, 0]],
    ],
)
def test_extreme_tables_give_finite_results(table):
    counts, rng = JointCounts(np.array(table, np.int64)), np.random.default_rng(0)
    found = eq1_test(counts, 99, rng)
    assert found.p is None or 0 < found.p <= 1
    assert 0 <= found.power(0.05) <= 1
    p = tost(counts, 2.0, 99, rng)
    assert p is None or 0 < p <= 1
    for estimate in predicted_and_ratio(counts, 200, rng):
        numbers = [x for x in (estimate.low, estimate.value, estimate.high) if x is not None]
        assert np.isfinite(numbers).all() and numbers == sorted(numbers)


def test_eq1_is_consistent_and_decided_if_everything_always_fails():
    counts = JointCounts(np.array([[0, 0], [0, 0], [0, 40]]))
    found = eq1_test(counts, 499, np.random.default_rng(0))
    assert found.p == 1.0
    assert found.power(0.05 / 9) > 0.99


def test_the_prediction_at_free_length_scales_with_the_length():
    assert predicted_at_free_length(0.5, [0.36], 50, 100) == pytest.approx(0.5 * 0.2)
    assert predicted_at_free_length(0.5, [0.36], 100, 100) == pytest.approx(0.5 * 0.36)
    assert predicted_at_free_length(0.5, [None], 50, 100) is None
    assert predicted_at_free_length(0.5, [0.1], None, 100) is None
