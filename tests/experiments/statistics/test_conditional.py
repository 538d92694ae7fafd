"""Odds ratios of two events within sequences and across their runs, on draws whose ratios are known."""

from math import asin, inf, pi
from types import SimpleNamespace

import numpy as np
import pytest

from dslab.experiments.statistics.conditional import conditional_odds_ratio, event_pairs, repeats
from dslab.experiments.statistics.difficulties import Margin, draw
from dslab.experiments.statistics.outcomes import Outcomes

HALF = Margin(0.5, 0.5)


def cell(columns, world="corridor"):
    """A cell with these outcomes (events, W, S, K)."""
    return SimpleNamespace(
        name="blur/1",
        outcomes=Outcomes(
            columns[0], columns[1:], columns[1:], [(world, i) for i in range(columns.shape[1])]
        ),
        world=world,
        threads=len(columns) - 1,
        shape=columns.shape[1:],
    )


def test_what_a_sequence_shares_shows_across_its_runs_and_not_within():
    """One difficulty of both events with r = .5: P(both) of two runs is that of normals correlated by .5."""
    both = 0.25 + asin(0.5) / (2 * pi)
    truth = (both / (0.5 - both)) ** 2
    rng = np.random.default_rng(0)
    (pair,) = event_pairs([cell(draw((HALF, HALF), 1.0, rng, (4000, 1, 3)))])
    assert pair.across.value == pytest.approx(truth, rel=0.1)
    assert pair.across.low < truth < pair.across.high
    assert pair.within.low < 1 < pair.within.high < 1.3


def test_what_a_run_shares_shows_within_sequences():
    """Odds 4 times as high where the first event happens, on top of what the sequence makes hard."""
    rng = np.random.default_rng(1)
    drawn = []
    for _ in range(3):
        hard = rng.normal(0, 1.5, (400, 1, 1))
        first = rng.random((400, 1, 3)) < 1 / (1 + np.exp(-hard))
        second = rng.random((400, 1, 3)) < 1 / (1 + np.exp(-(hard - 1 + np.log(4) * first)))
        drawn.append(cell(np.stack([first, second]).astype(float)))
    (pair,) = event_pairs(drawn)
    assert pair.within.value == pytest.approx(4, rel=0.3)
    assert 2 < pair.within.low < 4 < pair.within.high
    void = np.random.default_rng(2).random((400, 1, 3)) < 0.1
    columns = np.where(void, np.nan, drawn[0].outcomes.columns)
    (pair,) = event_pairs([cell(columns)])
    assert 1.5 < pair.within.low < 4 < pair.within.high, "void runs are no outcomes"


def test_what_a_run_shares_does_not_show_across_runs():
    rng = np.random.default_rng(4)
    first = rng.random((300, 1, 3)) < 0.5
    second = first ^ (rng.random((300, 1, 3)) < 0.2)
    (pair,) = event_pairs([cell(np.stack([first, second]).astype(float))])
    assert pair.within.low < 16 < pair.within.high and pair.across.low < 1 < pair.across.high < 2


def test_the_ratio_within_is_that_of_the_exact_likelihood():
    """Of runs (1, 1, 1) given one of three with each event: they coincide with chance r / (r + 2)."""
    coincide, apart = [1, 0, 0, 2], [0, 1, 1, 1]
    tables = np.array([coincide] * 9 + [apart] * 6 + [[0, 0, 2, 1]] * 50, float)
    found = conditional_odds_ratio(tables, np.arange(len(tables)))
    assert found.value == pytest.approx(2 * 9 / 6, rel=1e-3), "sequences in which one is fixed tell nothing"
    always = conditional_odds_ratio(tables[:9], np.arange(9))
    assert always.value == always.high == inf and 2 < always.low < inf
    assert conditional_odds_ratio(tables[:9], np.arange(9) // 5) is None, "two worlds"


def test_a_world_that_comes_again_tells_nothing_more():
    tables = np.array([[1, 0, 0, 2]] * 18 + [[0, 1, 1, 1]] * 12, float)
    once = conditional_odds_ratio(tables, np.arange(30))
    again = conditional_odds_ratio(np.tile(tables, (6, 1)), np.tile(np.arange(30), 6))
    assert again.high / again.low > 0.8 * once.high / once.low


def test_intervals_within_hold_the_truth():
    rng, missed = np.random.default_rng(3), 0
    for _ in range(200):
        (pair,) = event_pairs([cell(draw((HALF, HALF), 0.8, rng, (40, 1, 3)))])
        missed += not pair.within.low <= 1 <= pair.within.high
    assert missed <= 18


def test_two_populations_in_a_cell_show_at_both_ends_of_the_grid_of_runs():
    acts = np.arange(30)[:, None, None] < 20
    columns = np.broadcast_to(np.where(acts, 1.0, 0.0), (3, 30, 1, 3)).copy()
    columns[0, 0, 0, 0], columns[1, 1, 0, 0] = 0, np.nan
    first, second = repeats([cell(columns)])
    assert first.sequences == ((10, 0, 0, 0), (0, 0, 0, 0), (0, 0, 0, 1), (0, 0, 0, 18))
    assert (second.thread, sum(map(sum, second.sequences))) == (2, 30), "void is a run of thread 1 alone"
    assert repeats([cell(columns[..., :1])]) == ()
