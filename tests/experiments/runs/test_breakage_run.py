"""The demonstration: a breakage after which the base stays lost and Dual-SLAM recovers."""

import pytest

from experiments.evaluation.summary import summarise
from experiments.runs.execution import execute
from scenarios.loading import load_scenario
from sim.sequence_rendering import render_sequence


@pytest.mark.slow
def test_base_stays_lost_where_dual_slam_recovers():
    sequence = render_sequence(load_scenario("breakage", 1))
    base, dual = (summarise(execute(sequence, kind, 1)) for kind in ("base", "dual"))
    # Either may relocalize briefly, with too little in view to keep tracking.
    assert base["breakages"] >= 1 and base["share_tracked"] < 0.4
    assert dual["breakages"] >= 1 and dual["recoveries"] == 1 and dual["share_tracked"] > 0.9
    assert dual["ate_poses"] > 0.9 * dual["frames"] and dual["ate_m"] < 0.01 * dual["path_m"]
