"""Clopper-Pearson intervals against their definition and stated coverage."""

import numpy as np
import pytest
from scipy.stats import binom

from dslab.experiments.statistics.paper import clopper_pearson


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
