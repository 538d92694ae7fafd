"""Clopper-Pearson intervals against their definition and stated coverage."""

import numpy as np
import pytest
from scipy.stats import binom

from dslab.experiments.statistics.intervals import clopper_pearson


@pytest.mark.parametrize(
    ("events", "units"), [(0, 10), (1, 10), (5, 10), (10, 10), (30, 153), (24, 30), (0, 1)]
)
@pytest.mark.parametrize("confidence", [0.9, 0.95])
def test_at_each_end_the_observation_has_the_tail_probability(events, units, confidence):
    found, tail = clopper_pearson(events, units, confidence), (1 - confidence) / 2
    assert found.low == 0 if events == 0 else binom.sf(events - 1, units, found.low) == pytest.approx(tail)
    assert found.high == 1 if events == units else binom.cdf(events, units, found.high) == pytest.approx(tail)


def test_the_upper_end_without_events_has_a_closed_form():
    assert clopper_pearson(0, 10).high == pytest.approx(1 - 0.025 ** (1 / 10))


def test_the_published_recovery_interval():
    # 24 failures of thread 2 in 30: .61 to .92.
    found = clopper_pearson(24, 30)
    assert (round(found.low, 2), round(found.high, 2)) == (0.61, 0.92)


def test_the_interval_covers_at_least_as_stated():
    units = 12
    intervals = [clopper_pearson(k, units) for k in range(units + 1)]
    for p in np.linspace(0.01, 0.99, 33):
        covered = sum(binom.pmf(k, units, p) for k, i in enumerate(intervals) if i.low <= p <= i.high)
        assert covered >= 0.95 - 1e-12


def test_no_units_give_the_whole_range():
    found = clopper_pearson(0, 0)
    assert (found.estimate, found.low, found.high) == (None, 0.0, 1.0)


@pytest.mark.parametrize(("events", "units"), [(-1, 3), (4, 3)])
def test_impossible_counts_are_refused(events, units):
    with pytest.raises(ValueError):
        clopper_pearson(events, units)
