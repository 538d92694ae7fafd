"""The base on rendered scenarios: it closes loops and relocalizes."""

from dataclasses import replace

import numpy as np
import pytest
from slam_scenes import feed, kinds

from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.declared_audit import audit_declared
from dslab.experiments.runs.execution import record_of, slam_camera
from dslab.scenarios.loading import load_scenario
from dslab.sim.sequence_rendering import render_sequence
from dslab.slam.config import SlamConfig
from dslab.slam.factory import build_system
from dslab.slam.features.orb import OrbConfig

pytestmark = pytest.mark.slow


def rendered(name, seed, **changes):
    """The sequence of a scenario with other fields; of a shorter one with the segments that it still has."""
    scenario = load_scenario(name, seed)
    end_s = changes.get("duration_s", scenario.duration_s)
    held = tuple(segment for segment in scenario.segments if segment.start_s + segment.duration_s <= end_s)
    return render_sequence(scenario.model_copy(update={"segments": held, **changes}))


def base(sequence):
    return build_system("base", slam_camera(sequence.camera), 0)


def images(sequence, first=0):
    return (sequence.frames[i] for i in range(first, len(sequence)))


def run(sequence):
    """The base at the end of a sequence, and its results."""
    system = base(sequence)
    return system, feed(system, images(sequence), sequence.stamps_s, check=False)


def run_with_and_without_loop_closing(sequence):
    """The base at the end of a sequence, and a branch that closes no loop."""
    system, before = base(sequence), None
    for i, (image, stamp_s) in enumerate(zip(images(sequence), sequence.stamps_s, strict=True)):
        if i % 100 == 0 and "loop_closed" not in kinds(system):
            before = system.snapshot()
        system.process(image, float(stamp_s))
    system.finish()
    branch = before.restore()
    detector = branch.engine.store.places(branch.current_map_id).loops
    detector.config = replace(detector.config, min_gap=10**6)
    feed(branch, images(sequence, before.frames), sequence.stamps_s[before.frames :], check=False)
    return system, branch


def ate_m(system, sequence):
    pairs = metrics.associate(system.trajectories()[0], sequence.stamps_s, sequence.T_world_cam)
    return metrics.ate(pairs).rmse_m


def test_a_loop_around_a_block_is_closed_and_corrects_most_of_the_drift():
    sequence = rendered("loop/city", 3, duration_s=53.0)
    closed, open_ = run_with_and_without_loop_closing(sequence)
    # Refused from afar, where the view is a third as large, and closed half a second later.
    assert [k for k in kinds(closed) if k != "loop_refused"][:3] == [
        "initialized",
        "loop_closed",
        "map_adjusted",
    ]
    assert kinds(open_) == ["initialized"]
    assert ate_m(closed, sequence) <= ate_m(open_, sequence) / 2


def test_after_a_covered_lens_it_relocalizes_within_a_second():
    # A smaller room, so that the second lap comes sooner.
    written = load_scenario("covered-lens", 2)
    room = written.world.model_copy(update={"length_m": 5.0, "width_m": 4.5})
    covered = written.segments[0].model_copy(update={"start_s": 14.0})
    sequence = rendered("covered-lens", 2, world=room, segments=(covered,), duration_s=17.5)
    system, results = run(sequence)
    assert {"loop_closed", "map_adjusted"} <= set(kinds(system))
    assert kinds(system).count("breakage") == kinds(system).count("relocalized") == 1
    back = system.events[kinds(system).index("relocalized")]
    uncovered_s = sequence.stamps_s[sequence.segments[0].last_frame]
    assert 0 < back.stamp_s - uncovered_s <= 1.0
    assert all(r.T_map_cam is not None for r in results[back.frame :])
    assert ate_m(system, sequence) < 0.05
    found = audit_declared(record_of(system, sequence, "base", 0, results, wall_s=0.0))
    assert not any(found.false_counts.values()) and found.unjudged == 0
    assert all(f.audit.position_error_m < 0.7 * f.audit.position_bound_m for f in found.loops)
    judged = found.relocalizations[0].audit
    assert judged.largest_error_m < 0.7 * judged.position_bound_m
    assert np.isfinite(system.trajectories()[0].T_map_cam).all()


def test_walls_of_a_few_grey_levels_are_passed_by_their_faint_corners():
    sequence = rendered("stressed", 8105, duration_s=9.0)

    def passes(faint_share):
        config = SlamConfig(orb=OrbConfig(faint_share=faint_share))
        system = build_system("base", slam_camera(sequence.camera), 0, config)
        feed(system, images(sequence), sequence.stamps_s, check=False)
        return system

    with_faint, without = passes(1.0), passes(0.0)
    assert "breakage" in kinds(without) and "breakage" not in kinds(with_faint)
    assert ate_m(with_faint, sequence) < 0.01
