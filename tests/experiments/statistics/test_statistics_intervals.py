"""Jeffreys intervals and confidence sequences against their definitions and stated coverage."""

import numpy as np
import pytest
from experiment_tables import within_monte_carlo
from scipy.stats import binom

from experiments.statistics.intervals import clopper_pearson, jeffreys
from experiments.statistics.sequences import confidence_sequence


@pytest.mark.parametrize(("events", "units"), [(1, 10), (5, 10), (30, 153), (24, 30)])
def test_jeffreys_is_the_equal_tailed_interval_of_the_posterior(events, units):
    found = jeffreys(events, units, 0.9)
    share = (np.arange(200_000) + 0.5) / 200_000
    posterior = share ** (events - 0.5) * (1 - share) ** (units - events - 0.5)
    for outside in (share < found.low, share > found.high):
        assert posterior[outside].sum() / posterior.sum() == pytest.approx(0.05, abs=1e-4)


def test_jeffreys_covers_as_stated_on_average_over_true_shares():
    units, shares = 40, np.linspace(0.005, 0.995, 400)
    ends = [jeffreys(k, units) for k in range(units + 1)]
    inside = np.array([[i.low <= p <= i.high for p in shares] for i in ends])
    chance = binom.pmf(np.arange(units + 1)[:, None], units, shares[None])
    assert (inside * chance).sum(axis=0).mean() == pytest.approx(0.95, abs=0.005)


@pytest.mark.parametrize("interval", [jeffreys, confidence_sequence])
def test_ends_and_impossible_counts(interval):
    assert (interval(0, 0).low, interval(0, 0).high) == (0.0, 1.0)
    assert interval(0, 20).low == 0.0
    assert interval(20, 20).high == 1.0
    with pytest.raises(ValueError):
        interval(3, 2)
    with pytest.raises(ValueError):
        interval(1, 2, 1.0)


@pytest.mark.parametrize("p", [0.05, 0.3, 0.8])
def test_under_repeated_looks_the_sequence_covers_and_the_exact_interval_does_not(p):
    units, runs = 300, 400
    rng = np.random.default_rng(1)
    events = (rng.random((runs, units)) < p).cumsum(axis=1)

    def ever_outside(interval):
        inside = np.ones(runs, bool)
        for n in range(10, units + 1, 10):
            seen, index = np.unique(events[:, n - 1], return_inverse=True)
            found = [interval(int(k), n) for k in seen]
            inside &= np.array([i.low <= p <= i.high for i in found])[index]
        return 1 - inside.mean()

    assert ever_outside(confidence_sequence) <= 0.05
    assert ever_outside(clopper_pearson) > 0.08


def test_the_ends_of_the_sequence_are_where_the_mixture_refutes():
    found = confidence_sequence(7, 40)
    theta = (np.arange(200_000) + 0.5) / 200_000
    weight = theta**-0.5 * (1 - theta) ** -0.5
    for end in (found.low, found.high):
        ratio = (weight * (theta / end) ** 7 * ((1 - theta) / (1 - end)) ** 33).sum() / weight.sum()
        assert ratio == pytest.approx(20, rel=0.01)


def test_the_sequence_is_wider_than_the_exact_interval_and_narrows():
    assert confidence_sequence(12, 40).low < clopper_pearson(12, 40).low
    wide, narrow = confidence_sequence(30, 100), confidence_sequence(3000, 10_000)
    assert narrow.high - narrow.low < (wide.high - wide.low) / 7


def test_the_monte_carlo_helper_rejects_wrong_shares():
    assert within_monte_carlo(0.95, 0.95, 400)
    assert not within_monte_carlo(0.85, 0.95, 400)
