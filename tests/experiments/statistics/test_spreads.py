"""Intervals of means over runs: within the bounds, of the level that they say, none where nothing varies."""

import numpy as np
import pytest

from dslab.experiments.statistics.spreads import spread_of


def test_no_interval_leaves_the_bounds():
    share = spread_of([0.98, 0.99, 1.0], "share")
    amount = spread_of([0.01, 0.02, 0.5], "amount")
    assert share.mean is not None and share.low < share.mean < share.high <= 1 and share.low > 0.9
    assert amount.low == 0 and amount.high > 0.5 and spread_of([1 + 1e-9, 0.9999], "share").high <= 1


@pytest.mark.parametrize(
    ("values", "mean", "reason"),
    [
        ([0.85, 0.85 + 1e-12, 0.85], 0.85, "all alike"),
        ([0.02217992184, 0.02217992201], 0.0221799219, "all alike"),
        ([0.0, 0.0], 0.0, "all alike"),
        ([3.0, None, float("nan")], 3.0, "one run"),
        ([None], None, "no run"),
    ],
)
def test_where_nothing_varies_there_is_no_interval(values, mean, reason):
    found = spread_of(values, "amount")
    assert found.mean == (mean if mean is None else pytest.approx(mean))
    assert (found.low, found.high, found.reason) == (None, None, reason)


def test_an_interval_holds_the_mean_as_often_as_it_says():
    """Shares by the beta distribution, amounts by the gamma one; 8 runs each, 1500 times."""
    rng = np.random.default_rng(0)
    drawn = {"share": (rng.beta(18, 2, (1500, 8)), 0.9), "amount": (rng.gamma(4, 0.5, (1500, 8)), 2.0)}
    for bounds, (samples, mean) in drawn.items():
        found = [spread_of(values, bounds) for values in samples]
        assert np.mean([of.low <= mean <= of.high for of in found]) == pytest.approx(0.95, abs=0.025)
