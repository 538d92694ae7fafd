"""Analysis by kind of world, and shares with worlds as the sample."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from experiments.statistics.kinds_of_world import kinds_of_world, share_by_world

RECORDS = Path(__file__).resolve().parents[3] / "docs" / "eq1-quick" / "units.parquet"


def test_the_first_run_is_explained_by_its_kinds_of_world():
    found = kinds_of_world(pd.read_parquet(RECORDS), 2)
    assert len(found.mixed) == 9 and found.worlds == 15 and found.units == 522
    assert [level.predicted_by_kind for level in found.levels] == pytest.approx([0.241, 0.190], abs=0.001)
    assert [level.predicted_by_cell for level in found.levels] == pytest.approx([0.170, 0.085], abs=0.001)
    rows = [row for row in found.rows if row.world == "room" and not row.cell.startswith("fast")]
    assert (sum(row.breakages for row in rows), sum(row.units for row in rows)) == (1, 120)


def test_the_interval_of_a_prediction_is_students_where_every_thread_fails():
    """Eq. 1 is then p0 itself, a mean over worlds of equal size."""
    broke = np.random.default_rng(3).random((6, 5)) < 0.4
    table = pd.DataFrame(
        {
            "outcome": "completed",
            "cell": "fog/1",
            "world": "room",
            "world_seed": np.repeat(np.arange(6), 5),
            "breakage": broke.ravel(),
            "cross_r1_failed": True,
            "d1": broke.ravel(),
            "silent_failure": False,
        }
    )
    level = kinds_of_world(table, 1).levels[0]
    means = broke.mean(axis=1)
    low, high = stats.t.interval(0.95, 5, means.mean(), stats.sem(means))
    assert level.predicted_by_kind == pytest.approx(means.mean())
    assert level.predicted_interval == pytest.approx((max(low, 0), min(high, 1)))
    assert kinds_of_world(table[table["world_seed"] == 0], 1).levels[0].predicted_interval is None


def test_an_interval_over_worlds_covers_where_one_over_units_does_not():
    rng = np.random.default_rng(1)
    covered, runs = 0, 300
    for _ in range(runs):
        hard = np.repeat(rng.beta(1, 1, 30), 20)
        share = share_by_world(rng.random(600) < hard, pd.Series(np.repeat(np.arange(30), 20)))
        covered += share.low <= 0.5 <= share.high
    assert covered / runs > 0.91


def test_no_rows_give_no_share():
    assert share_by_world(np.zeros(0, bool), pd.Series([], dtype=int)) is None
