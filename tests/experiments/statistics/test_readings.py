"""Both readings of Eq. 1, over rescuable units too, and the way to the weakest link, where they are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from dslab.experiments.statistics import estimates
from dslab.experiments.statistics.difficulties import Margin, draw
from dslab.experiments.statistics.outcomes import Outcomes, world_means
from dslab.experiments.statistics.readings import both_readings, rescuable_readings
from dslab.experiments.statistics.world_intervals import way_interval

HALF = Margin(0.5, 0.5)


def cell(columns, rescuable=None, name="blur/1", world="corridor"):
    """A cell with outcomes (1 + n, W, S, K), D being Q, and with (W, S, K) units rescuable or not."""
    worlds = [(world, i) for i in range(columns.shape[1])]
    outcomes = Outcomes(columns[0], columns[1:], np.cumprod(columns, axis=0)[1:], worlds)
    return SimpleNamespace(
        name=name,
        world=world,
        outcomes=outcomes,
        usable=lambda n: outcomes.of_first(n).with_units(),
        says=lambda column: rescuable is not None and column == "rescuable",
        values=lambda column: rescuable.astype(float),
    )


def test_what_holds_for_each_sequence_need_not_hold_for_averages():
    """Both fail by the sequence's difficulty, r = .5: in 1/3 of the runs, and in 1/4 by the averages."""
    rng = np.random.default_rng(0)
    drawn = [cell(draw((HALF, HALF), 1.0, rng, (600, 1, 3)), name=f"blur/{i}") for i in (1, 2)]
    pooled, first, second = both_readings(drawn, 1)
    assert (pooled.cell, first.cell, second.cell, pooled.units) == (None, "blur/1", "blur/2", 3600)
    for found in (pooled, first, second):
        assert found.of_sequences.predicted == pytest.approx(1 / 3, abs=0.03)
        assert found.of_averages.predicted == pytest.approx(1 / 4, abs=0.03)
        assert found.of_sequences.ratio.low < 1 < found.of_sequences.ratio.high < 1.1
        assert found.of_averages.ratio.low > 1.1
        assert found.of_averages.ratio == found.of_averages.ratio_in_units, "D is Q here"
    assert pooled.of_averages.difference.low > 0.05 and first.of_averages.difference is None
    assert pooled.measured.value == pytest.approx((first.measured.value + second.measured.value) / 2)
    wide = first.of_averages.ratio.high - first.of_averages.ratio.low
    assert pooled.of_averages.ratio.high - pooled.of_averages.ratio.low < wide


def test_cells_weigh_alike_and_a_world_leaves_all_of_its_cells():
    columns = draw((HALF, HALF), 0.0, np.random.default_rng(1), (90, 1, 3))
    once = both_readings([cell(columns)], 1)[0]
    again, *_ = both_readings([cell(columns), cell(columns, name="blur/2")], 1)
    assert again.worlds == 90 and again.measured.low == pytest.approx(once.measured.low)
    few = np.ones_like(columns[:, :10])
    pooled, *_ = both_readings([cell(columns), cell(few, world="room")], 1)
    assert pooled.measured.value == pytest.approx(0.5 * once.measured.value + 0.5)


def test_over_rescuable_units_a_hopeless_part_of_the_worlds_is_no_longer_shared():
    rng = np.random.default_rng(2)
    columns = draw((HALF, HALF), 0.0, rng, (400, 1, 3))
    hopeless = np.broadcast_to(np.arange(400)[:, None, None] < 120, (400, 1, 3))
    columns = np.where(hopeless, 1.0, columns)
    (all_units,), (found,) = (
        both_readings([cell(columns)], 1),
        rescuable_readings([cell(columns, ~hopeless)], 1),
    )
    assert all_units.of_averages.ratio.low > 1.05
    assert found.readings.units == 3 * 280 and found.readings.of_averages.ratio.low < 1
    assert found.hopeless == 360 and found.failures == columns.prod(axis=0).sum()
    (none,) = rescuable_readings([cell(columns, np.zeros((400, 1, 3)))], 1)
    assert none.readings is None and none.hopeless == none.failures
    assert rescuable_readings([cell(columns)], 1) == []


def figures(columns):
    outcomes = Outcomes(columns[0], columns[1:], np.cumprod(columns, axis=0)[1:])
    means = world_means(columns)
    weakest = estimates.Figure.mean(means[int(np.argmin(means.mean(axis=1)))])
    return estimates.dual_failure(outcomes), estimates.product_of_margins(outcomes), weakest


@pytest.mark.parametrize(
    ("p0", "pr", "correlation"), [(0.4, 0.4, 0.0), (0.4, 0.4, 1.0), (0.08, 0.08, 0.0), (0.83, 0.04, 0.0)]
)
def test_the_way_is_0_for_eq1_and_its_interval_holds_it(p0, pr, correlation):
    rng, missed, truth = np.random.default_rng(3), 0, 0.0
    margins = (Margin(p0, 0.8), Margin(pr, 0.8))
    if correlation:
        both = draw(margins, correlation, rng, (40_000, 1, 3)).prod(axis=0).mean()
        truth = (both - p0 * pr) / (min(p0, pr) - p0 * pr)
    for _ in range(200):
        found = way_interval(*figures(draw(margins, correlation, rng, (100, 1, 3))))
        missed += found is not None and not found.low <= truth <= found.high
    assert missed <= 18


def test_the_way_of_failures_that_few_worlds_have_is_not_taken_for_sure():
    columns = np.zeros((2, 100, 1, 3))
    columns[0, :20], columns[1, 20:40] = 1, 1
    found = way_interval(*figures(columns))
    assert found.value < 0 and found.high == pytest.approx(0, abs=0.2) and found.high > found.value
    assert way_interval(*figures(np.ones((2, 100, 1, 3)))) is None, (
        "no room between Eq. 1 and the weakest link"
    )
