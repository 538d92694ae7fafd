"""The base over rendered scenarios: it closes loops, finds its place again, and takes the drift out."""

from dataclasses import replace

import numpy as np
import pytest

from experiments import metrics
from experiments.execution import execute
from scenarios.loading import load_scenario
from sim.render import render_sequence
from slam.camera import PinholeCamera
from slam.config import default_config
from slam.factory import build_system


def without_loops(kind, camera: PinholeCamera, seed):
    """The base with a loop detector that is never asked."""
    config = default_config(camera)
    return build_system(kind, camera, seed, replace(config, loops=replace(config.loops, min_gap=10**9)))


def ate_m(record):
    pairs = metrics.associate(record.trajectories[0], record.sequence.stamps_s, record.sequence.T_world_cam)
    return metrics.ate(pairs).rmse_m


@pytest.mark.slow
def test_a_block_is_closed_and_most_of_the_drift_goes():
    scenario = load_scenario("loop/city", 3)
    sequence = render_sequence(scenario.model_copy(update={"duration_s": 60.0}))
    closed, open_ = execute(sequence, "base", 0), execute(sequence, "base", 0, build=without_loops)
    assert [e.kind for e in closed.events][:3] == ["initialized", "loop_closed", "map_adjusted"]
    assert [e.kind for e in open_.events] == ["initialized"]
    assert ate_m(closed) <= ate_m(open_) / 3


@pytest.mark.slow
def test_after_a_covered_lens_it_finds_its_place_within_a_second():
    sequence = render_sequence(load_scenario("covered-lens"), 2)
    record = execute(sequence, "base", 2)
    kinds = [e.kind for e in record.events]
    assert kinds.count("breakage") == kinds.count("relocalized") == 1
    back = record.events[kinds.index("relocalized")]
    uncovered_s = sequence.stamps_s[sequence.segments[0].last_frame]
    assert 0 < back.stamp_s - uncovered_s <= 1.0
    tracked = [r.T_map_cam is not None for r in record.results]
    assert all(tracked[back.frame :])
    assert ate_m(record) < 0.05
    assert np.isfinite(record.trajectories[0].T_map_cam).all()
