"""Every interval that the statistics give holds the estimate beside it."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.statistics.clustering import cluster_bootstrap, gee_share
from experiments.statistics.dependence import PairedCounts, conditional_ratio, mantel_haenszel, phi
from experiments.statistics.dose_response import dose_response
from experiments.statistics.eq1 import predicted_and_ratio
from experiments.statistics.heterogeneity import beta_factor, eckhardt_lee, mixture
from experiments.statistics.intervals import clopper_pearson, jeffreys
from experiments.statistics.joint import JointCounts
from experiments.statistics.kinds_of_world import share_by_world
from experiments.statistics.results import DosePoint, Estimate
from experiments.statistics.sequences import confidence_sequence

DRAWS = 400
QUICK = settings(deadline=None, max_examples=40, derandomize=True)

few = st.integers(0, 9)
tables = st.lists(few, min_size=12, max_size=12).map(
    lambda counts: JointCounts(np.array(counts, np.int64).reshape(3, 4))
)
rows = st.lists(st.tuples(st.booleans(), st.booleans(), st.integers(0, 3)), min_size=1, max_size=20)


def check(estimate: Estimate) -> None:
    assert estimate.low is None or estimate.high is None or estimate.low < estimate.high
    assert not [x for x in (estimate.value, estimate.low, estimate.high) if x is not None and np.isnan(x)]
    if estimate.value is not None:
        assert estimate.low is None or estimate.low <= estimate.value
        assert estimate.high is None or estimate.value <= estimate.high


@QUICK
@given(st.lists(tables, min_size=1, max_size=3))
def test_of_eq_1_within_and_over_cells(cells):
    rng = np.random.default_rng(0)
    for estimate in predicted_and_ratio(cells[0], DRAWS, rng):
        check(estimate)
    pooled, common = eckhardt_lee(cells, DRAWS, rng), beta_factor(dict(enumerate(cells)))
    if pooled is not None:
        check(pooled.within)
        check(pooled.pooled)
    if common is not None:
        check(common.beta)


def test_of_eq_1_where_one_cell_always_fails_and_the_other_never():
    easy, hard = np.zeros((2, 3, 4), np.int64)
    easy[0, 0] = hard[2, 3] = 4
    found = eckhardt_lee([JointCounts(easy), JointCounts(hard)], DRAWS, np.random.default_rng(0))
    assert found.within.value == 0.5 and found.within.low < 0.5 < found.within.high < 0.9


@QUICK
@given(st.tuples(few, few, few, few))
def test_of_dependence(cells):
    for figure in (conditional_ratio, phi):
        check(figure(PairedCounts(*cells), DRAWS, np.random.default_rng(0)))


@QUICK
@given(st.lists(st.integers(0, 2), min_size=1, max_size=12))
def test_of_two_classes_of_breakages(failed):
    found = mixture(failed, 2, DRAWS, np.random.default_rng(0))
    check(found.share_hopeless)
    check(found.pr_rest)


@QUICK
@given(st.lists(st.tuples(few, few), min_size=2, max_size=4))
def test_of_dose_and_response(counts):
    points = [DosePoint(d, clopper_pearson(min(c), max(c))) for d, c in enumerate(counts)]
    fit = dose_response("fog", "p0", points)
    for estimate in (fit.slope, fit.intercept, fit.ed50):
        check(estimate)
    assert all(low <= share <= high for _, share, low, high in fit.curve)


@QUICK
@given(rows)
def test_of_shares_over_worlds(found):
    event, factor, world = (np.array(column) for column in zip(*found, strict=True))
    share = share_by_world(event, pd.Series(world))
    assert share.low is None or share.low <= share.value <= share.high
    check(cluster_bootstrap(event, world, DRAWS, np.random.default_rng(0)))
    check(gee_share(event, world))
    check(mantel_haenszel(event, factor, world)[0])


def test_worlds_that_agree_give_no_interval():
    event, world = np.array([True, False] * 4), np.arange(8) // 2
    for estimate in (
        cluster_bootstrap(event, world, DRAWS, np.random.default_rng(0)),
        gee_share(event, world),
    ):
        assert estimate.value == pytest.approx(0.5) and estimate.low is estimate.high is None


@pytest.mark.parametrize("interval", [clopper_pearson, jeffreys, confidence_sequence])
def test_of_shares(interval):
    for units in range(1, 15):
        for events in range(units + 1):
            found = interval(events, units)
            assert 0 <= found.low <= events / units <= found.high <= 1
