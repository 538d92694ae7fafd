"""Units per hour and the shares of CPU time add up."""

import time

import pytest
from unit_fakes import MadeUp, made_up_record

from dslab.experiments.benchmarks.experiment import bench_experiment


def busy_unit(unit, cache_dir=None):
    """Spend a quarter of a second of CPU, and report a part as rendering, most as SLAM."""
    assert cache_dir is not None
    end_s = time.process_time() + 0.25
    while time.process_time() < end_s:
        pass
    return made_up_record(unit) | {"render_s": 0.04, "slam_s": 0.2}


@pytest.mark.slow
def test_figures_of_units_with_known_cost_add_up():
    told = []
    figures = bench_experiment(MadeUp({"a": 1, "b": 1}), 6, 2, busy_unit, lambda *p: told.append(p))
    assert [(lap["workers"], lap["units"]) for lap in figures["laps"]] == [(1, 6), (2, 6)]
    for lap in figures["laps"]:
        assert (lap["render_s"], lap["slam_s"]) == (pytest.approx(0.24), pytest.approx(1.2))
        assert lap["cpu_s"] > 1.4  # six quarters, and the clock of a process counts in hundredths
        shares = [lap[f"{part}_share"] for part in ("render", "slam", "overhead")]
        assert sum(shares) == pytest.approx(1) and min(shares) > 0
        assert lap["units_per_hour"] == pytest.approx(6 * 3600 / lap["wall_s"])
    assert figures["speed_up"] > 0 and 0.5 < figures["speed_up_cores_free"] < 4
    assert ("1 worker", 6, 6) in told and ("2 workers", 6, 6) in told
