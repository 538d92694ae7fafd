"""Threads beside each other: shares, what each adds, odds ratios, with worlds as the sample."""

import numpy as np
import pandas as pd
import pytest

from dslab.experiments.eq1.records import columns, thread_column
from dslab.experiments.statistics.from_records import cells_of
from dslab.experiments.statistics.threads import thread_pairs, thread_shares


def table(failures, rescuable=None):
    """Records of (3 threads, W worlds, K replicates) failures in the crossing arm of one cell."""
    threads, worlds, replicates = failures.shape
    rows = []
    for world in range(worlds):
        for repeat in range(replicates):
            row = {
                "cell": "blur/1",
                "kind": "blur",
                "severity": 1.0,
                "world": "corridor",
                "world_seed": 10 + world,
                "index": world * replicates + repeat,
                "sequence": 0,
                "repeat": repeat,
                "outcome": "completed",
                "breakage": True,
                "rescuable": None if rescuable is None else bool(rescuable[world, repeat]),
            }
            row |= {
                thread_column("cross", j + 1, "failed"): bool(failures[j, world, repeat])
                for j in range(threads)
            }
            rows.append(dict.fromkeys(columns(threads)) | row)
    return pd.DataFrame(rows)


def cells(failures, rescuable=None):
    return cells_of(table(failures, rescuable), len(failures))


def test_shares_and_what_a_thread_adds_to_those_before_it():
    rng = np.random.default_rng(0)
    failures = rng.random((3, 40, 3)) < 0.5
    rescuable = rng.random((40, 3)) < 0.5
    shares = thread_shares(cells(failures, rescuable))
    assert [share.thread for share in shares] == [1, 2, 3]
    third, before = shares[2], failures[0] & failures[1]
    assert third.failed.value == pytest.approx(failures[2].mean())
    assert (third.units, third.needed) == (120, before.sum())
    assert third.adds.value == pytest.approx((before & ~failures[2]).sum() / before.sum())
    assert third.adds.low < 0.5 < third.adds.high
    assert third.rescuable == rescuable.sum()
    assert third.failed_rescuable.value == pytest.approx(failures[2][rescuable].mean())


def test_odds_ratio_tells_unlike_threads_from_like_ones():
    rng = np.random.default_rng(1)
    hard = rng.random((60, 3)) < 0.5
    noise = rng.random((3, 60, 3)) < 0.2
    # Thread 2 fails where thread 1 does, thread 3 where it does not.
    failures = np.stack([hard ^ noise[0], hard ^ noise[1], ~hard ^ noise[2]])
    like, unlike, _ = thread_pairs(cells(failures))
    counts = (like.both, like.only_first, like.only_second, like.neither)
    one, other = failures[:2]
    told = [(one & other).sum(), (one & ~other).sum(), (~one & other).sum(), (~one & ~other).sum()]
    assert counts == tuple(told)
    both, first, second, neither = (count + 0.5 for count in counts)
    assert like.odds_ratio.value == pytest.approx(both * neither / (first * second))
    assert like.odds_ratio.low > 1 and unlike.odds_ratio.high < 1


@pytest.mark.slow
def test_interval_of_the_odds_ratio_takes_worlds_as_the_sample():
    """Replicates that repeat their world tell nothing more: the interval stays as wide."""
    rng = np.random.default_rng(2)
    failures = rng.random((2, 50, 1)) < 0.5
    once, again = (thread_pairs(cells(np.repeat(failures, k, axis=2)))[0].odds_ratio for k in (1, 8))
    assert again.high / again.low > 0.8 * once.high / once.low
    covered = 0
    for _ in range(200):
        world = rng.random((2, 30, 1)) < 0.5
        found = thread_pairs(cells(np.repeat(world, 3, axis=2)))[0].odds_ratio
        covered += found.low <= 1 <= found.high
    assert covered >= 182


def test_a_thread_that_never_fails_has_no_odds_ratio():
    failures = np.zeros((2, 10, 2), bool)
    failures[0, :5] = True
    assert thread_pairs(cells(failures))[0].odds_ratio is None
    shares = thread_shares(cells(failures))
    assert shares[1].needed == 10 and shares[1].adds.value == 1
