"""Intervals against their definition and stated coverage."""

import numpy as np
import pytest
from scipy.stats import binom

from dslab.experiments.statistics.paper import clopper_pearson
from dslab.experiments.statistics.world_intervals import median_interval


@pytest.mark.parametrize(
    ("events", "units"), [(0, 10), (1, 10), (5, 10), (10, 10), (30, 153), (24, 30), (0, 1)]
)
def test_at_each_end_the_observation_has_the_tail_probability(events, units):
    found = clopper_pearson(events, units)
    assert found.low == 0 if events == 0 else binom.sf(events - 1, units, found.low) == pytest.approx(0.025)
    assert (
        found.high == 1 if events == units else binom.cdf(events, units, found.high) == pytest.approx(0.025)
    )


def test_the_upper_end_without_events_has_a_closed_form_and_no_units_give_the_whole_range():
    assert clopper_pearson(0, 10).high == pytest.approx(1 - 0.025 ** (1 / 10))
    found = clopper_pearson(0, 0)
    assert (found.estimate, found.low, found.high) == (None, 0.0, 1.0)


def test_the_interval_covers_at_least_as_stated():
    units = 12
    intervals = [clopper_pearson(k, units) for k in range(units + 1)]
    for p in np.linspace(0.01, 0.99, 33):
        covered = sum(binom.pmf(k, units, p) for k, i in enumerate(intervals) if i.low <= p <= i.high)
        assert covered >= 0.95 - 1e-12


def test_the_interval_of_a_median_covers_it_in_at_least_95_percent_whatever_the_distribution():
    ordered = np.arange(30.0)
    found = median_interval(ordered[::-1])
    assert (found.value, found.low, found.high) == (14.5, 9.0, 20.0)  # 10th and 21st: Conover's table for 30
    assert median_interval(ordered[:5]).high == np.inf and median_interval(ordered[:6]).high == 5
    drawn = np.random.default_rng(0).exponential(size=(2000, 30))
    covers = [found.low <= np.log(2) <= found.high for found in map(median_interval, drawn)]
    assert 0.945 < np.mean(covers) < 0.97  # exactly .957
