"""Systems are compared on the units that both completed, with worlds as the sample."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from dslab.experiments.eq1.record_table import data_frame
from dslab.experiments.eq1.records import columns
from dslab.experiments.statistics.systems import compare_systems, exchange_test

SYSTEMS = {f"{image}/{system}": system for image in ("low_texture/1", "sham") for system in ("a", "b")}
IMAGES = {cell: cell.rpartition("/")[0] for cell in SYSTEMS}


def row(cell: str, index: int, broke: bool | None, **more) -> dict:
    """A unit; two replicates of a world. Without an outcome it is void."""
    known = {"outcome": "void"} if broke is None else {"outcome": "completed", "breakage": broke, "m1": broke}
    return dict.fromkeys(columns(1)) | {
        "cell": cell, "kind": cell.partition("/")[0], "severity": 1.0, "index": index, "world": "room",
        "world_seed": index // 2, "sequence": 0, "repeat": index % 2, **known, **more,
    }  # fmt: skip


def compared(rows: list[dict]):
    return compare_systems(data_frame(rows, 1), 1, SYSTEMS, IMAGES)


def of(found, failure="breakage"):
    return next(pair for pair in found.over_doses if pair.failure == failure)


def test_only_units_that_both_completed_are_compared():
    """Of four, system b is void in the one that a breaks in: nothing is left that differs."""
    rows = [row("low_texture/1/a", i, i == 3) for i in range(4)]
    rows += [row("low_texture/1/b", i, None if i == 3 else False) for i in range(4)]
    pair = of(compared(rows))
    assert (pair.units, pair.left_out, pair.worlds) == (3, 1, 2)
    assert (pair.only_first, pair.only_second, pair.difference, pair.p) == (0, 0, 0.0, 1.0)
    assert pair.interval is None


def test_worlds_weigh_alike_and_the_difference_is_signed():
    rows = [row("low_texture/1/a", i, i in (0, 1, 2)) for i in range(6)]
    rows += [row("low_texture/1/b", i, i == 5) for i in range(6)]
    pair = of(compared(rows))
    assert (pair.first, pair.second, pair.only_first, pair.only_second) == ("a", "b", 3, 1)
    assert pair.difference == pytest.approx(np.mean([1, 0.5, -0.5]))
    assert pair.interval.low < 0 < pair.interval.high


def test_a_sham_is_shown_and_not_tested_and_what_a_system_does_not_say_is_left_out():
    rows = [row(f"sham/{s}", i, False) for s in "ab" for i in range(4)]
    rows += [row("low_texture/1/a", i, i < 2, silent_failure=i == 3) for i in range(4)]
    rows += [row("low_texture/1/b", i, i < 2, declares="nothing") for i in range(4)]
    found = compared(rows)
    assert {pair.failure for pair in found.over_doses} == {"breakage", "mission_failure"}
    assert {pair.image for pair in found.per_condition} == {"low_texture/1", "sham"}
    shares = {s.cell: s for s in found.shares}
    assert shares["low_texture/1/a"].shares["silent_failure"].value == 0.5  # of the unbroken ones, by worlds
    assert "silent_failure" not in shares["low_texture/1/b"].shares
    assert shares["low_texture/1/b"].declares == ("nothing",)


def test_what_dual_slam_gains_over_a_system_is_counted_and_tested_by_itself():
    systems = {f"fog/1/{name}": name for name in ("a", "dual(a,recovery=b)", "b")}
    images = dict.fromkeys(systems, "fog/1")
    rows = [row("fog/1/a", i, i < 10, world_seed=i) for i in range(12)]
    rows += [row("fog/1/b", i, i % 2 == 0, world_seed=i) for i in range(12)]
    for i in range(12):
        joins = i < 8
        thread = {
            "rescuable": i < 9,
            "free_r1_declared": joins,
            "free_r1_failed": i >= 7,
            "free_r1_false": i == 7,
        }
        broke = i < 10
        over = row("fog/1/dual(a,recovery=b)", i, broke, world_seed=i, **(thread if broke else {}))
        rows.append(over | {"m1": 7 <= i < 10})
    found = compare_systems(data_frame(rows, 1), 1, systems, images)
    (gain,) = found.gains
    assert (gain.missions.first, gain.missions.second) == ("a", "dual(a,recovery=b)")
    assert (gain.fails, gain.fails_with, gain.missions.only_first, gain.missions.only_second) == (10, 3, 7, 0)
    assert (gain.breakages, gain.rescuable, gain.recovered) == (10, 9, 7)
    assert (gain.joins, gain.false) == (8, 1)
    assert gain.missions.p == pytest.approx(2 * 0.5**7), "tested once: other pairs are not in its family"


def test_exchanges_are_those_of_the_exact_test_of_signs():
    """With equal sizes the test of exchanges is the sign test; of a few worlds no p is small."""
    rng = np.random.default_rng(0)
    assert exchange_test(np.ones(3), rng) == 0.25
    worlds = np.array([1.0] * 9 + [-1.0] * 2)
    assert exchange_test(worlds, rng) == pytest.approx(stats.binomtest(9, 11).pvalue)
    assert exchange_test(np.tile(worlds, 2), rng) == pytest.approx(stats.binomtest(18, 22).pvalue, abs=0.004)


def test_alike_systems_are_told_apart_as_often_as_the_level_says():
    """Whatever the worlds decide: outcomes within a world are the same in nine of ten runs."""
    rng = np.random.default_rng(5)
    hits = 0
    for _ in range(400):
        hard = rng.random((20, 1)) < 0.5
        a, b = (np.where(rng.random((20, 3)) < 0.9, hard, rng.random((20, 3)) < 0.5) for _ in range(2))
        hits += exchange_test((a.astype(float) - b).mean(axis=1), rng) <= 0.05
    assert hits / 400 <= 0.07


def test_the_comparison_does_not_depend_on_the_order_of_rows():
    rows = [row(cell, i, (i * 7 + len(cell)) % 3 == 0) for cell in SYSTEMS for i in range(8)]
    table = data_frame(rows, 1)
    shuffled = table.sample(frac=1, random_state=1)
    first, again = (compare_systems(t, 1, SYSTEMS, IMAGES) for t in (table, pd.DataFrame(shuffled)))
    assert set(first.over_doses) == set(again.over_doses)
