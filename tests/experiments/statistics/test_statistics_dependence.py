"""Dependence of paired outcomes, clusters, and the GEE, against statsmodels and known truth."""

import numpy as np
import pytest
from experiment_tables import at_most
from scipy.stats import fisher_exact
from statsmodels.stats.contingency_tables import StratifiedTable, Table2x2
from statsmodels.stats.contingency_tables import mcnemar as mcnemar_oracle

from experiments.statistics.clustering import cluster_bootstrap, gee_odds_ratio, gee_share
from experiments.statistics.dependence import (
    PairedCounts,
    conditional_ratio,
    fisher,
    mantel_haenszel,
    mcnemar,
    phi,
)


def _worlds(rng, worlds, per_world, shared, odds=1.0, p=0.3):
    """Two outcomes whose odds share a world's difficulty and, within worlds, an odds ratio."""
    index = np.repeat(np.arange(worlds), per_world)
    base = np.log(p / (1 - p)) + (rng.normal(size=worlds) * shared)[index]
    a = rng.random(index.size) < 1 / (1 + np.exp(-base))
    r = rng.random(index.size) < 1 / (1 + np.exp(-base - a * np.log(odds)))
    return a, r, index


@pytest.mark.parametrize("odds", [1.0, 5.0])
def test_rho_and_phi_cover_as_stated(odds):
    p_a, weights = 0.3, np.array([0.3 * odds, 0.7])
    p_r_a = weights[0] / weights.sum()
    p_r = p_a * p_r_a + (1 - p_a) * 0.3
    cells = np.array([p_a * p_r_a, p_a * (1 - p_r_a), (1 - p_a) * 0.3, (1 - p_a) * 0.7])
    true_phi = (cells[0] * cells[3] - cells[1] * cells[2]) / np.sqrt(p_a * (1 - p_a) * p_r * (1 - p_r))
    rng, held = np.random.default_rng(4), []
    for drawn in rng.multinomial(60, cells, size=400):
        counts = PairedCounts(*map(int, drawn))
        rho, correlation = conditional_ratio(counts, 400, rng), phi(counts, 400, rng)
        held.append((rho.low <= p_r_a / p_r <= rho.high, correlation.low <= true_phi <= correlation.high))
    assert np.all(np.mean(held, axis=0) >= 0.95 - 0.015 - 3 * np.sqrt(0.05 * 0.95 / 400))


def test_counts_and_their_figures():
    counts = PairedCounts.of_units(np.array([1, 1, 1, 0, 0], bool), np.array([1, 1, 0, 1, 0], bool))
    assert counts.table == [[2, 1], [1, 1]]
    rng = np.random.default_rng(0)
    assert conditional_ratio(counts, 100, rng).value == pytest.approx((2 / 3) / (3 / 5))
    # Pearson's chi-squared without correction is N phi squared.
    found = phi(PairedCounts(12, 5, 4, 19), 100, rng)
    oracle = Table2x2([[12, 5], [4, 19]], shift_zeros=False).test_nominal_association().statistic
    assert 40 * found.value**2 == pytest.approx(oracle)
    assert fisher(PairedCounts(12, 5, 4, 19)) == pytest.approx(fisher_exact([[12, 5], [4, 19]])[1])
    assert mcnemar(PairedCounts(12, 9, 2, 19)) == pytest.approx(
        mcnemar_oracle([[12, 9], [2, 19]], exact=True).pvalue
    )


@pytest.mark.parametrize(
    "cells", [(0, 0, 0, 0), (0, 0, 5, 5), (5, 5, 0, 0), (7, 0, 0, 0), (0, 0, 0, 7), (0, 4, 4, 0)]
)
def test_empty_margins_give_finite_results(cells):
    counts, rng = PairedCounts(*cells), np.random.default_rng(0)
    for estimate in (conditional_ratio(counts, 50, rng), phi(counts, 50, rng)):
        assert all(x is None or np.isfinite(x) for x in (estimate.value, estimate.low, estimate.high))
    assert (mcnemar(counts) is None) == (counts.units == 0)
    if cells != (0, 4, 4, 0):
        assert fisher(counts) is None


def test_mcnemar_and_fisher_have_at_most_their_size():
    rng = np.random.default_rng(5)
    a, r = rng.random((2, 600, 40)) < 0.3
    tables = [PairedCounts.of_units(x, y) for x, y in zip(a, r, strict=True)]
    assert at_most(np.mean([mcnemar(t) <= 0.05 for t in tables]), 0.05, 600)
    assert at_most(np.mean([fisher(t) <= 0.05 for t in tables]), 0.05, 600)


def test_mantel_haenszel_is_statsmodels():
    a, r, world = _worlds(np.random.default_rng(6), 12, 20, 1.0, odds=3.0)
    found, p = mantel_haenszel(a, r, world)
    tables = [PairedCounts.of_units(a[world == w], r[world == w]).table for w in range(12)]
    oracle = StratifiedTable([np.array(t, float) for t in tables])
    assert found.value == pytest.approx(oracle.oddsratio_pooled)
    assert (found.low, found.high) == pytest.approx(oracle.oddsratio_pooled_confint())
    assert p == pytest.approx(oracle.test_null_odds().pvalue)


def test_worlds_of_uneven_difficulty_are_dependent_overall_but_not_within_worlds():
    rng = np.random.default_rng(7)
    whole, within = [], []
    for _ in range(100):
        a, r, world = _worlds(rng, 60, 10, 2.0)
        whole.append(fisher(PairedCounts.of_units(a, r)) <= 0.05)
        within.append(mantel_haenszel(a, r, world)[1] <= 0.05)
    assert np.mean(whole) > 0.95
    assert at_most(np.mean(within), 0.05, 100)


def test_dependence_within_worlds_is_found():
    a, r, world = _worlds(np.random.default_rng(8), 60, 10, 1.0, odds=6.0)
    found, p = mantel_haenszel(a, r, world)
    assert p < 1e-4 and found.low < 6 < found.high


@pytest.mark.parametrize("worlds", [np.arange(6), np.zeros(6, int), np.zeros(0, int)])
def test_uninformative_strata_give_no_odds_ratio(worlds):
    a = np.array([1, 1, 0, 0, 1, 1], bool)[: worlds.size]
    found, p = mantel_haenszel(a, np.ones(worlds.size, bool), worlds)
    assert (found.value, p) == (None, None)


def test_clusters_widen_the_interval_so_that_it_covers():
    rng = np.random.default_rng(9)
    drawn = [_worlds(rng, 40, 5, 2.0) for _ in range(150)]
    truth = np.mean([_worlds(rng, 2000, 5, 2.0)[0].mean() for _ in range(20)])
    by_world = [cluster_bootstrap(a, world, 400, rng) for a, _, world in drawn]
    by_unit = [cluster_bootstrap(a, np.arange(a.size), 400, rng) for a, _, _ in drawn]
    held, ignored = (np.mean([e.low <= truth <= e.high for e in found]) for found in (by_world, by_unit))
    # The percentile interval of forty clusters covers slightly less than stated.
    assert held > 0.95 - 0.015 - 3 * np.sqrt(0.05 * 0.95 / 150)
    assert ignored < 0.87


def test_the_bootstrap_has_no_interval_without_spread():
    rng = np.random.default_rng(0)
    assert cluster_bootstrap(np.zeros(0, bool), [], 50, rng).value is None
    none = cluster_bootstrap(np.zeros(9, bool), np.arange(9), 50, rng)
    assert (none.value, none.low, none.high) == (0.0, None, None)
    assert cluster_bootstrap(np.array([True, False]), [3, 3], 50, rng).low is None


def test_gee_agrees_with_the_cluster_bootstrap():
    rng = np.random.default_rng(10)
    a, _, world = _worlds(rng, 80, 5, 1.5)
    one, other = gee_share(a, world), cluster_bootstrap(a, world, 4000, rng)
    assert (one.value, one.low, one.high) == pytest.approx((other.value, other.low, other.high), abs=0.015)


def test_gee_odds_ratio_covers_the_truth_and_accepts_uninformative_groups():
    rng, held = np.random.default_rng(11), []
    for _ in range(40):
        a, r, world = _worlds(rng, 50, 6, 0.0, odds=4.0)
        cell = world % 2
        found = gee_odds_ratio(r, a, world, cell)
        held.append(found.low <= 4 <= found.high)
    assert np.mean(held) >= 0.85
    always = np.ones(8, bool)
    assert gee_odds_ratio(always, always, np.arange(8)).value is None
    assert gee_odds_ratio(np.zeros(0, bool), np.zeros(0, bool), []).value is None
    assert gee_share(np.zeros(5, bool), np.arange(5)).low is None
