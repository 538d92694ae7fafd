"""Estimates, intervals, tests and verdicts with worlds as the sample."""

from dataclasses import replace
from itertools import permutations, product
from math import inf

import numpy as np
import pytest
from scipy import stats

from dslab.experiments.statistics import estimates
from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.formulas import beta_factor, compare_formulas, eq1, one_factor, weakest_link
from dslab.experiments.statistics.outcomes import Outcomes, sequence_means, world_means
from dslab.experiments.statistics.permutations import independence, within_sequences
from dslab.experiments.statistics.products import product_of_distinct, product_without_each
from dslab.experiments.statistics.simulated import Truth, simulate
from dslab.experiments.statistics.verdicts import (
    Comparison,
    Verdict,
    compare_forecast,
    compare_units,
    corrected,
    holm,
    verdicts,
)
from dslab.experiments.statistics.world_intervals import (
    few_events,
    ratio_interval,
    share_interval,
    t_of_log_ratio,
)


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def of_kind(kind, outcomes, first=0):
    return replace(outcomes, worlds=[(kind, first + seed) for _, seed in outcomes.worlds])


def over_choices(x):
    """The definition: mean over all choices of distinct rows."""
    rows = [r for r in range(x.shape[1]) if np.isfinite(x[:, r]).all()]
    return np.mean(
        [np.prod([x[c, r] for c, r in enumerate(chosen)]) for chosen in permutations(rows, len(x))]
    )


@pytest.mark.parametrize("columns", [1, 2, 3, 4])
def test_products_are_means_over_choices_of_distinct_rows(rng, columns):
    x = rng.random((columns, 6))
    assert product_of_distinct(x) == pytest.approx(over_choices(x))
    without = [over_choices(np.delete(x, r, axis=1)) for r in range(6)]
    assert product_without_each(x) == pytest.approx(without)
    x[0, 2] = np.nan
    assert product_of_distinct(x[:, None])[0] == pytest.approx(over_choices(x))
    assert np.isnan(product_of_distinct(x[:, : columns - 1]))


def test_products_are_unbiased_although_the_factors_depend_on_each_other(rng):
    """In units and sequences B and R_1 are one draw; the product of the margins is .16 all the same."""
    truth = Truth((0.4, 0.4), correlation=1.0, common=1.0)
    drawn = [simulate(truth, rng, worlds=8, sequences=2, replicates=3) for _ in range(1500)]
    names = ("measured_in_units", "product_in_sequences", "product_in_worlds", "product_of_margins")
    means = [np.mean([getattr(estimates, name)(outcomes).value for outcomes in drawn]) for name in names]
    assert means == pytest.approx([0.4, 0.4, 0.4, 0.16], abs=0.015)


def test_the_chain_multiplies_to_what_is_measured_over_eq1(rng):
    outcomes = simulate(Truth((0.5, 0.6, 0.5), 0.5, 0.3, arms=0.8), rng, worlds=40, sequences=3, replicates=4)
    steps = estimates.chain(outcomes)
    ratio = {name: a.value / c.value for name, (a, c) in steps.items()}
    whole = ratio.pop("whole")
    assert set(ratio) == {"arms", "run", "path", "world"} and np.prod([*ratio.values()]) == pytest.approx(
        whole
    )
    one = estimates.chain(simulate(Truth((0.5, 0.6)), rng, worlds=40, sequences=1, replicates=2))
    assert set(one) == {"sequence", "run", "arms", "whole"}
    alone = estimates.chain(simulate(Truth((0.5, 0.6)), rng, worlds=40))
    assert set(alone) == {"arms", "whole"}


def test_worlds_weigh_alike_and_void_replicates_nothing():
    x = np.full((2, 2, 3), np.nan)
    x[0, 0, :2], x[0, 1, 0], x[1, 0] = (1, 0), 1, (0, 0, 1)
    assert sequence_means(x)[0].tolist() == [0.5, 1.0] and np.isnan(sequence_means(x)[1, 1])
    assert world_means(x) == pytest.approx([0.75, 1 / 3])
    figure = estimates.share(x)
    assert figure.value == pytest.approx((0.75 + 1 / 3) / 2) and figure.without == pytest.approx(
        [1 / 3, 0.75]
    )
    assert figure.pseudo_values == pytest.approx([0.75, 1 / 3])


def test_a_sequence_without_enough_replicates_leaves_at_that_number_of_threads(rng):
    outcomes = simulate(Truth((0.5, 0.5, 0.5)), rng, worlds=3, sequences=1, replicates=3)
    for x in (outcomes.breakage, *outcomes.thread_failures, *outcomes.dual_failures):
        x[0, 0, 0] = np.nan
    assert outcomes.of_first(1).with_units().worlds == outcomes.worlds
    assert outcomes.of_first(2).with_units().worlds == outcomes.worlds[1:]


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.9])
def test_the_correlation_within_sequences_is_found(rng, correlation):
    outcomes = simulate(Truth((0.4, 0.5), correlation), rng, worlds=3000, replicates=3)
    between, whole = estimates.correlation_in_sequences(outcomes.breakage)
    assert between.value / whole.value == pytest.approx(correlation, abs=0.04)
    assert estimates.correlation_in_sequences(outcomes.breakage[..., :1]) is None


# -- intervals -----------------------------------------------------------------------------------------------


def test_a_share_has_as_many_trials_as_the_spread_of_its_worlds_is_worth():
    means = np.repeat([0.0, 1.0], [30, 10])
    z = stats.t.ppf(0.975, 39)
    trials = 0.25 * 0.75 * 40 / np.var(means, ddof=1)
    found = share_interval(means)
    for end in (found.low, found.high):  # Wilson: the shares that lie z standard deviations from the estimate
        assert abs(0.25 - end) == pytest.approx(z * np.sqrt(end * (1 - end) / trials))
    even = share_interval(np.full(40, 0.25))
    assert even.low == pytest.approx(share_interval(means).low, abs=0.01)
    none = share_interval(np.zeros(40))
    assert none.value == none.low == 0 and 0.05 < none.high < 0.12


def test_a_ratio_has_the_values_that_the_worlds_do_not_contradict(rng):
    a, c = Figure.mean(rng.normal(2, 0.3, 50)), Figure.mean(rng.normal(1, 0.1, 50))
    found = ratio_interval(a, c)
    t = stats.t.ppf(0.975, 49)
    for rho in (found.low, found.high):
        rest = a.pseudo_values - rho * c.pseudo_values
        assert abs(rest.mean()) == pytest.approx(t * rest.std(ddof=1) / np.sqrt(50))
    assert ratio_interval(a, Figure.mean(np.zeros(50))) is None
    for worlds in (12, 60, 300):
        for p, q in ((0.1, 0.3), (1 / 3, 1 / 9), (2 / 3, 0.7), (0.9, 0.27)):
            alike = ratio_interval(Figure.mean(np.full(worlds, p)), Figure.mean(np.full(worlds, q)))
            assert alike.low == alike.value == alike.high
    loose = ratio_interval(a, Figure.mean(rng.normal(0.1, 2.0, 50)))
    assert loose is None or inf in (loose.high, -loose.low)


def test_a_ratio_of_rare_events_is_as_wide_as_that_of_counts():
    nothing, product = Figure.mean(np.zeros(100)), Figure.mean(np.full(100, 0.02))
    assert few_events(np.zeros(100)) and few_events(np.ones(100), (0.1, 0.2))
    assert not few_events(np.ones(100), (0.5, 0.5))
    assert ratio_interval(nothing, product).high == 0
    found = ratio_interval(nothing, product, (0.1, 0.2))
    # By hand: (rho c)^2 = t^2 / W (rho pi - rho^2 pi^2 (1 + sum(1 / p - 1))).
    factor = stats.t.ppf(0.975, 99) ** 2 / 100
    assert found.low == 0 and found.high == pytest.approx(factor * 0.02 / (0.02**2 * (1 + factor * 14)))


def test_rounding_is_no_difference_no_spread_and_no_event():
    tenths = np.full(20, 0.1) + 0.2  # .30000000000000004
    same = Figure.mean(tenths) - Figure.mean(np.full(20, 0.3))
    assert same.value != 0 and (same.t, same.error) == (0.0, 0.0)
    assert (Figure.mean(tenths) - Figure.mean(np.full(20, 0.2))).t == inf
    small = Figure.mean(np.where(np.arange(20) < 5, 1e-9, 0)) - Figure.mean(np.zeros(20))
    assert small.t == pytest.approx(stats.ttest_1samp(small.pseudo_values, 0).statistic)

    shaken = np.where(np.arange(40) % 2, 0.3, 0.1 + 0.2)
    assert share_interval(shaken) == pytest.approx(share_interval(np.full(40, 0.3)))
    once = Figure.mean(np.where(np.arange(50) == 0, 1.0, 0.0))
    assert (once.pseudo_values > 0).sum() > 5 and few_events(once.pseudo_values)
    # All that the columns have is in one row: no choice of distinct rows has any of it.
    row = np.zeros((3, 12))
    row[:, 7] = 0.7, 0.7, 0.3
    assert product_of_distinct(row) == 0 and not product_without_each(row).any()


# -- tests and verdicts --------------------------------------------------------------------------------------


def test_permuting_worlds_finds_what_units_share_and_nothing_else(rng):
    shared = simulate(Truth((0.5, 0.5), correlation=1.0, common=1.0), rng, worlds=40, replicates=2)
    found = independence(shared, rng, 499)
    assert found.sign == 1 and found.p == pytest.approx(2 / 500)
    assert found.expected == pytest.approx(found.statistic**2, abs=0.02), "B and R are one draw"
    # Outcomes that the world determines, but each for itself.
    p = [independence(simulate(Truth((0.5, 0.5), 1.0), rng, 30, 1, 2), rng, 99).p for _ in range(200)]
    assert np.mean(np.array(p) <= 0.05) < 0.09


def test_permuted_worlds_keep_their_replicates_in_order_and_skip_void_ones():
    b, r = np.array([[[1, 0]], [[0, 1]], [[1, np.nan]]]), np.array([[[1, 0]], [[0, 1]], [[0, np.nan]]])
    outcomes = Outcomes(b, r[None], (b * r)[None])
    found = independence(outcomes, np.random.default_rng(0), 2000)
    pairs = np.array([[np.nanmean(b[w] * r[v]) for v in range(3)] for w in range(3)])
    every = [np.mean([pairs[w, v] for w, v in enumerate(order)]) for order in permutations(range(3))]
    assert found.statistic == pytest.approx(every[0]) and found.expected == pytest.approx(
        np.mean(every), abs=0.01
    )


def test_void_replicates_make_no_failures_rarer_where_worlds_are_moved(rng):
    """All fail in every valid unit, wherever its thread's outcome comes from."""
    fails = np.where(rng.random((40, 2, 2)) < 0.6, np.nan, 1.0)
    found = independence(Outcomes(fails, fails[None], fails[None]), rng, 99)
    assert (found.statistic, found.expected, found.p) == (1, 1, 1)


def test_chance_that_replicates_share_is_found_within_sequences(rng):
    shared = simulate(Truth((0.5, 0.5), common=1.0), rng, worlds=60, replicates=4, void=0.1)
    found = within_sequences([shared, shared], rng, 299)
    assert found.p == pytest.approx(2 / 300) and found.sign == 1 and found.telling > 20
    apart = [within_sequences([simulate(Truth((0.5, 0.5)), rng, 60, 1, 3)], rng, 99).p for _ in range(150)]
    assert np.mean(np.array(apart) <= 0.05) < 0.1
    determined = simulate(Truth((0.5, 0.5), correlation=1.0, common=1.0), rng, worlds=60, replicates=4)
    assert within_sequences([determined], rng).p is None and within_sequences([determined], rng).telling == 0


def test_only_sequences_that_enter_are_telling(rng):
    """The first replicate, alone in what it does, is void in another cell of the same worlds."""
    first = np.zeros((30, 1, 3))
    first[..., 0] = 1
    alone = Outcomes(first, first[None], first[None])
    assert within_sequences([alone], rng, 19).telling == 30
    other = Outcomes(*(np.where(first == 1, np.nan, x) for x in (first, first[None], first[None])))
    assert within_sequences([alone, other], rng, 19).telling == 0
    # In another kind of world it is another sequence, and where a cell has no sequence it takes none away.
    assert within_sequences([of_kind("corridor", alone), other], rng, 19).telling == 30
    lacking = Outcomes(first + np.nan, first[None] + np.nan, first[None] + np.nan)
    assert within_sequences([alone, lacking], rng, 19).telling == 30


def test_replicates_move_alike_in_all_cells_of_a_kind_of_world_and_apart_in_others(rng):
    cell = simulate(Truth((0.5, 0.5), common=0.1), rng, worlds=40, replicates=3)
    one, alike, apart = (
        within_sequences([of_kind(kind, cell) for kind in kinds], np.random.default_rng(1), 499)
        for kinds in (["room"], ["room", "room"], ["room", "corridor"])
    )
    assert alike.p == one.p and alike.statistic == apart.statistic == pytest.approx(2 * one.statistic)
    assert apart.p < one.p, "two samples that agree are more than one"


@pytest.mark.parametrize(
    ("truth", "worlds", "expected"),
    [
        (Truth((0.5, 0.5), common=0.8), 150, Verdict.OPTIMISTIC),
        (Truth((0.5, 0.5)), 900, Verdict.CONSISTENT),
        (Truth((0.5, 0.5)), 25, Verdict.UNDECIDED),
        (Truth((0.98, 0.6)), 150, Verdict.SATURATED),
        (Truth((0.02, 0.5)), 60, Verdict.UNTESTED),
    ],
)
def test_the_first_verdict_that_applies(rng, truth, worlds, expected):
    outcomes = simulate(truth, rng, worlds)
    units = compare_units(outcomes, independence(outcomes, rng, 999))
    assert verdicts([units], [compare_forecast(outcomes)]) == ([expected], [expected])


def test_fewer_failures_than_predicted_are_pessimistic(rng):
    outcomes = simulate(Truth((0.5, 0.5)), rng, 150)
    opposite = Outcomes(outcomes.breakage, 1 - outcomes.breakage[None], 0 * outcomes.dual_failures)
    assert verdicts([], [compare_forecast(opposite)]) == ([], [Verdict.PESSIMISTIC])


def test_a_log_ratio_has_the_variance_of_counts_where_events_are_rare():
    worlds, product = 100, Figure(0.02, np.full(100, 0.02))
    for count, shares, variance in (
        (8, (), 1 / 0.04 - 1),
        (1, (), 1 / 0.01 - 1),
        (0, (), 1 / 0.005 - 1),
        (1, (0.2, 0.1), 1 / 0.01 - 1 - 4 - 9),
    ):
        failed = Figure.mean((np.arange(worlds) < count).astype(float))
        expected = np.log(max(count, 0.5) / 2) / np.sqrt(variance / worlds)
        assert t_of_log_ratio(failed, product, shares) == pytest.approx(expected)
    many = Figure.mean((np.arange(worlds) < 50).astype(float))
    assert t_of_log_ratio(many, Figure(0.25, np.full(worlds, 0.25))) == pytest.approx(
        np.log(2) / (0.5 / 0.5 / 10), rel=0.02
    )
    assert t_of_log_ratio(many, Figure(0.01, np.append(np.full(99, 0.01), 0.0))) is None


def test_a_forecast_of_few_failures_is_untested_and_independence_is_not(rng):
    def outcomes(shared):
        """B in 20 of 100 worlds, R_1 in 15, some of them the same."""
        broke, failed = (np.zeros((100, 1, 1)) for _ in range(2))
        broke[:20], failed[20 - shared : 35 - shared] = 1, 1
        return Outcomes(broke, failed[None], (broke * failed)[None])

    def judged(shared):
        cell = outcomes(shared)
        forecast = compare_forecast(cell)
        units = compare_units(cell, independence(cell, rng, 999))
        return forecast.p, *(of[0] for of in verdicts([units], [forecast]))

    p, on_units, on_forecast = judged(4)
    assert (p, on_units, on_forecast) == (None, Verdict.UNDECIDED, Verdict.UNTESTED)
    p, on_units, on_forecast = judged(10)
    assert p < 0.01 and on_units == on_forecast == Verdict.OPTIMISTIC
    tested = Comparison(*(Figure.mean(np.full(20, x)) for x in (0.2, 0.1, 0.4)), 0.03, 1.0, untested=False)
    assert corrected([tested, compare_forecast(outcomes(4))]) == [0.06, None]


def test_a_product_that_no_two_worlds_have_is_not_saturated():
    nothing = Figure.mean(np.zeros(20))
    assert not Comparison(nothing, nothing, Figure.mean(np.full(20, 0.3)), 1.0, 1.0, untested=False).saturated


def test_holm_counts_every_confirmatory_comparison():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    flat = Figure.mean(np.full(20, 0.2))
    close = Comparison(flat, flat.times(0.5), flat.times(2), p=0.03, p_equivalent=1.0, untested=False)
    other = Comparison(flat, flat.times(0.5), flat.times(2), p=0.9, p_equivalent=1.0, untested=False)
    assert verdicts([close], [])[0] == [Verdict.OPTIMISTIC]
    assert verdicts([close, other], [])[0] == [Verdict.UNDECIDED] * 2
    assert verdicts([close], [other])[0] == [Verdict.OPTIMISTIC], "the forecasts are another family"


def test_independence_takes_many_threads_and_does_not_depend_on_what_is_in_memory_together(rng, monkeypatch):
    outcomes = simulate(Truth((0.5,) * 6, 0.3, 0.4), rng, 40, 2, 2, void=0.1)
    found = independence(outcomes, np.random.default_rng(1), 300)
    assert found.p < 0.05 and found.expected < found.statistic
    monkeypatch.setattr("dslab.experiments.statistics.permutations._AT_ONCE", 1000)
    assert independence(outcomes, np.random.default_rng(1), 300) == found


# -- formulas ------------------------------------------------------------------------------------------------


def test_formulas_reach_from_eq1_to_the_weakest_link():
    p = np.array([[0.3, 0.5], [0.2, 0.9]])
    for formula in (beta_factor, one_factor):
        assert (formula(p, 0.0) == eq1(p)).all()
        assert formula(p, 1e-6) == pytest.approx(eq1(p), abs=1e-5)
        between = np.array([formula(p, x) for x in (0.2, 0.5, 0.8)])
        assert (np.diff(between, axis=0) > 0).all()
        assert (formula(p, 0.95) <= weakest_link(p)).all()
    assert beta_factor(p, 1.0) == pytest.approx(weakest_link(p))
    normal = stats.multivariate_normal([0, 0], [[1, 0.4], [0.4, 1]])
    assert one_factor(p, 0.4) == pytest.approx([normal.cdf(stats.norm.ppf(each)) for each in p], abs=1e-4)
    # Both fail: the common cause with .5 * .3, else each by what is left of it.
    assert beta_factor(p[:1], 0.5)[0] == pytest.approx(0.15 + 0.85 * (0.15 / 0.85) * (0.35 / 0.85))


def test_the_formula_that_made_the_outcomes_predicts_unseen_worlds_best(rng):
    truths = [Truth((a, b), common=0.7) for a, b in product((0.3, 0.6), repeat=2)]
    cells = [simulate(truth, rng, worlds=150) for truth in truths]
    scores = {s.name: s for s in compare_formulas(cells, [True] * 4)[0]}
    assert scores["beta factor"].gain.low > 0 and scores["beta factor"].p < 0.01
    assert scores["beta factor"].score < scores["weakest link"].score
    assert np.abs(scores["beta factor"].calibration).max() < 0.1
    assert scores["Eq. 1"].gain is None and scores["ceiling"].p is None
    assert 0.5 < scores["beta factor"].parameter < 0.9 and scores["weakest link"].parameter is None
    independent = [simulate(Truth(truth.shares), rng, worlds=150) for truth in truths]
    again = {s.name: s for s in compare_formulas(independent, [True] * 4)[0]}
    assert min(again[name].p for name in ("weakest link", "beta factor", "one factor")) > 0.05
    assert again["Eq. 1"].score < again["weakest link"].score
    assert again["beta factor"].parameter < 0.15 and again["one factor"].parameter < 0.15


def test_a_formula_that_is_eq1_by_its_fit_gains_nothing_over_it():
    """B and R_1 seldom fail together, so that no common cause is fitted; rounding is no gain."""
    broke = (np.arange(60) % 10 < 4).astype(float).reshape(60, 1, 1)
    failed = (np.arange(60) % 10 > 2).astype(float).reshape(1, 60, 1, 1)
    scores = {s.name: s for s in compare_formulas([Outcomes(broke, failed, broke * failed)], [True])[0]}
    for name in ("beta factor", "one factor"):
        assert (scores[name].gain.low, scores[name].gain.high, scores[name].p) == (0, 0, 1)


def test_kinds_of_world_are_independent_samples_of_a_mean_over_cells(rng):
    rooms, corridors = rng.normal(1, 1, (2, 30)), rng.normal(2, 3, 12)
    worlds = [[(kind, i) for i in range(n)] for kind, n in (("room", 30), ("room", 30), ("corridor", 12))]
    found = estimates.mean_over_cells([*rooms, corridors], worlds)
    assert found.value == pytest.approx(np.mean([*rooms.mean(axis=1), corridors.mean()]))
    parts = np.array([4 / 9 * rooms.mean(axis=0).var(ddof=1) / 30, 1 / 9 * corridors.var(ddof=1) / 12])
    assert found.error**2 == pytest.approx(parts.sum(), rel=0.1)
    assert found.freedom == pytest.approx(parts.sum() ** 2 / (parts**2 / [29, 11]).sum(), rel=0.1)
    # Two cells of the same worlds are one sample: their difference has no error but its own.
    same = estimates.mean_over_cells([rooms[0], rooms[0]], worlds[:2])
    assert same.error == pytest.approx(Figure.mean(rooms[0]).error)


def test_a_world_is_left_out_of_its_own_kind_alone(rng):
    """What is fitted to all cells shows whether a world of another kind with the same seed is left out."""
    cells = [simulate(Truth((0.4, 0.5), 0.5, common=0.5), rng, worlds, replicates=2) for worlds in (20, 30)]

    def scores(*firsts):
        named = [of_kind(kind, cell, seed) for (kind, seed), cell in zip(firsts, cells, strict=True)]
        return [s.score for s in compare_formulas(named, [True, True])[0]]

    apart = scores(("corridor", 0), ("room", 0))
    assert apart == scores(("corridor", 0), ("room", 99)) != scores(("room", 0), ("room", 0))


def test_a_formula_is_scored_on_worlds_that_it_has_not_seen(rng):
    """One world alone fails; the ceiling, the mean of the others, says 0 for it and not 1 in 20."""
    x = np.zeros((20, 1, 1))
    x[0] = 1
    cell = Outcomes(x, x[None], x[None])
    ceiling = compare_formulas([cell], [True])[0][-1]
    seen = np.array([0.5 / 20] + [1.5 / 20] * 19)
    assert ceiling.score == pytest.approx(-(np.log(seen[0]) + np.log(1 - seen[1:]).sum()) / 20)
