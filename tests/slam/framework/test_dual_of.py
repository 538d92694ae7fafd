"""Dual-SLAM over systems that play a script."""

import numpy as np
import pytest
from odometry_scripts import CAMERA, Script, dual_of, image_of, told, walk

from dslab.slam.core.events import Breakage, Fusion, LoopClosed, RecoveryEnd, TrackingState
from dslab.slam.framework.alignment import align
from dslab.slam.framework.dual_of import DualOf
from dslab.slam.optimization.sim3 import moved

GAP = set(range(80, 95))


def errors_m(system: DualOf, truth: np.ndarray) -> np.ndarray:
    """Distances of the largest map's poses from the truth, aligned as a whole."""
    path = system.trajectories()[0]
    S = align(path.T_map_cam, truth[path.frames], system.framework.seam).S_b_a
    return np.linalg.norm(moved(S, path.T_map_cam)[:, :3, 3] - truth[path.frames, :3, 3], axis=1)


def test_a_breakage_is_crossed_backward_and_both_maps_become_one():
    truth = walk()
    script, thread = Script(truth, blind=set(GAP), noise=0.002), Script(truth, noise=0.002)
    system = dual_of(script.kind("x"), thread.kind("y"))
    assert told(system) == [
        "breakage", "map_saved", "reinit_start", "reinit_done", "recovery_start", "recovery_end", "fusion",
    ]  # fmt: skip
    (path,) = system.trajectories()
    assert path.frames.tolist() == list(range(200)), "the recovery's poses stand in the gap"
    assert errors_m(system, truth).max() < 0.05
    (back,) = thread.begun
    assert back.is_backward and back.seen == sorted(back.seen, reverse=True)
    assert back.stamps_s[0] == 0 and np.all(np.diff(back.stamps_s) > 0)
    assert [s.is_finished for s in (*script.begun, back)] == [1, 1, 1]
    end = next(e for e in system.events if isinstance(e, RecoveryEnd))
    assert end.success and end.method == "y" and len(end.placed) == 30
    fusion = system.events[-1]
    assert isinstance(fusion, Fusion) and fusion.relation is not None
    # In the old map, both sides lie as in the world.
    for side in (fusion.relation.old, fusion.relation.new):
        old = script.begun[0]
        np.testing.assert_allclose(side.T_map_cam, moved(old.S, truth[side.frames]), atol=0.15)


def test_what_is_given_frame_by_frame_lies_in_the_fused_map_from_the_fusion_on():
    truth, given = walk(), {}
    script = Script(truth, blind=set(GAP))
    system = DualOf(CAMERA, 7, script.kind(points=True), [Script(truth).kind()])
    for index in range(200):
        result = system.process(image_of(index), 0.1 * index)
        given[index] = result
    assert given[85].state is TrackingState.LOST and given[85].T_map_cam is None
    assert [given[k].map_id for k in (70, 100, 150)] == [0, 1, 0]
    np.testing.assert_allclose(given[150].T_map_cam, moved(script.begun[0].S, truth[150]), atol=1e-6)
    system.finish()
    assert system.maps() == [0]
    assert len(system.map_points(0)) > 150


def test_until_the_first_breakage_it_is_the_system_itself():
    truth = walk(60)
    script = Script(truth)
    system = dual_of(script.kind(), frames=60)
    alone = script.kind().begin(7, 0, None)
    for index in range(60):
        alone.process(image_of(index), 0.1 * index)
    np.testing.assert_array_equal(system.trajectories()[0].T_map_cam, alone.trajectories()[0].T_map_cam)
    assert told(system) == []


@pytest.mark.parametrize(
    ("thread", "stage", "reason"),
    [
        (Script(walk(), blind={88}), "propagation", "blind"),
        (Script(walk(), after=500), "propagation", "not_initialized"),
        (Script(walk(), drift=1.02), "sim3", "residual"),
        (Script(walk(), after=25), "overlap", "too_short"),
    ],
)
def test_a_recovery_that_fails_says_where_and_why(thread, stage, reason):
    system = dual_of(Script(walk(), blind=set(GAP)).kind(), thread.kind(), starts=1)
    ends = [e for e in system.events if isinstance(e, RecoveryEnd)]
    assert [(e.success, e.stage, e.reason) for e in ends] == [(False, stage, reason)]
    assert len(system.trajectories()) == 2


def test_threads_run_in_order_until_one_succeeds_and_start_again_with_a_longer_map():
    truth = walk()
    bad, good = Script(truth, blind={88}), Script(truth)
    system = dual_of(Script(truth, blind=set(GAP)).kind(), bad.kind("bad"), good.kind("good"))
    assert [e.method for e in system.events if isinstance(e, RecoveryEnd)] == ["bad", "good"]
    late = Script(truth, after=35)  # begins too late for a short map
    system = dual_of(Script(truth, blind=set(GAP)).kind(), late.kind())
    ends = [e for e in system.events if isinstance(e, RecoveryEnd)]
    assert [(e.success, e.frame) for e in ends] == [(False, 124), (True, 154)]
    both = dual_of(Script(truth, blind=set(GAP)).kind(), good.kind("1"), good.kind("2"), exhaustive=True)
    assert [e.method for e in both.events if isinstance(e, RecoveryEnd)] == ["1", "2"]
    assert told(both).count("fusion") == 1


def test_a_pure_rotation_behind_the_gap_is_refused():
    truth = walk()
    truth[95:, :3, 3] = truth[95, :3, 3]
    noisy = {"noise": 0.01}
    system = dual_of(Script(truth, blind=set(GAP), **noisy).kind(), Script(truth, **noisy).kind())
    assert {e.reason for e in system.events if isinstance(e, RecoveryEnd)} == {"residual"}


def test_poses_that_broke_the_map_are_replaced_by_the_recoverys():
    truth = walk()
    wrong = truth.copy()
    wrong[70:80, :3, 3] += np.linspace(0.2, 2.0, 10)[:, None]
    system = dual_of(Script(wrong, blind=set(GAP)).kind(), Script(truth).kind())
    withdrawn = next(e for e in system.events if e.kind == "poses_withdrawn")
    assert (withdrawn.last_frame, withdrawn.reason) == (79, "passed_over_by_recovery")
    assert errors_m(system, truth).max() < 0.05


def test_a_last_pose_that_nothing_but_the_recovery_contradicts_is_replaced():
    truth = walk()
    wrong = truth.copy()
    wrong[79, :3, 3] += 0.5
    noise = {"noise": 0.005}
    system = dual_of(Script(wrong, blind=set(GAP), **noise).kind(), Script(truth, **noise).kind())
    withdrawn = next(e for e in system.events if e.kind == "poses_withdrawn")
    assert (withdrawn.first_frame, withdrawn.last_frame) == (79, 79)
    assert errors_m(system, truth).max() < 0.1


def test_a_lost_system_that_finds_back_goes_on_in_its_map():
    truth = walk()
    forward = Script(truth, blind=set(GAP), returns_at={110})
    blocked = Script(truth, blind={100})
    system = dual_of(forward.kind(returns=True), blocked.kind())
    assert system.maps()[0] == 0 and system.trajectories()[0].frames[-1] == 199
    assert set(range(95, 110)).isdisjoint(system.trajectories()[0].frames.tolist())
    gone = dual_of(Script(truth, blind=set(GAP), returns_at={110}).kind(), blocked.kind())
    assert gone.trajectories()[0].frames[-1] == 199 and gone.maps()[0] == 1, "not asked, it is not fed"


def test_a_recovery_that_can_find_back_passes_over_what_it_cannot_cross():
    truth = walk()
    thread = Script(truth, blind={85, 86}, returns_at={84})
    system = dual_of(Script(truth, blind=set(GAP)).kind(), thread.kind(returns=True))
    end = next(e for e in system.events if isinstance(e, RecoveryEnd))
    assert end.success and end.frames_passed_over == 2
    assert set(range(200)) - set(system.trajectories()[0].frames.tolist()) == {85, 86}


def test_a_system_that_declares_nothing_is_watched():
    truth = walk()
    silent = Script(truth)
    jumps = truth.copy()
    jumps[90:, :3, 3] += [3.0, 0.0, 0.0]
    system = dual_of(Script(jumps).kind(losses=False), silent.kind())
    (breakage,) = [e for e in system.events if isinstance(e, Breakage)]
    assert (breakage.frame, breakage.reason) == (90, "beyond_its_own_steps")
    declared = dual_of(Script(jumps).kind(losses=True), silent.kind())
    assert not [e for e in declared.events if isinstance(e, Breakage)]


def test_a_map_too_short_to_be_aligned_is_dropped_and_its_frames_are_crossed():
    truth = walk()
    forward = Script(truth, blind=GAP | {100})
    system = dual_of(forward.kind(), Script(truth).kind())
    assert told(system).count("map_dropped") == 1 and told(system).count("fusion") == 1
    assert len(system.trajectories()) == 1 and len(system.trajectories()[0].frames) == 200


def test_nothing_is_recovered_that_has_left_the_buffer():
    truth = walk()
    late = Script(truth, blind=set(range(80, 150)))
    system = dual_of(late.kind(), Script(truth).kind(), buffer_cap_s=5.0, buffer_s=2.0)
    assert "recovery_start" not in told(system) and len(system.trajectories()) == 2


def test_events_of_a_system_are_told_in_frames_of_the_sequence():
    script = Script(walk(), blind=set(GAP))

    def each(system):
        if system.frames == 120:
            script.begun[-1].close_loop()

    system = dual_of(script.kind(), Script(walk(), blind={88}).kind(), each=each)
    (loop,) = [e for e in system.events if isinstance(e, LoopClosed)]
    assert (loop.frame, loop.keyframe, loop.loop_keyframe, loop.map_id) == (119, 119, 118, 1)
    assert loop.relation.new.frames.tolist() == [119]


def test_a_cut_map_is_reached_from_the_one_after_the_restart():
    truth = walk()
    system = DualOf(CAMERA, 7, Script(truth).kind(), [])
    for index in range(200):
        if index == 80:
            system.cut()
        if index == 95:
            system.restart()
        result = system.process(image_of(index), 0.1 * index)
        assert (result.T_map_cam is None) is (80 <= index < 95)
    branched = system.snapshot().restore()
    system.finish()
    assert len(system.trajectories()[0].frames) == 200 and told(system)[0] == "map_cut"
    assert branched.frames == 200
    with pytest.raises(RuntimeError, match="restart without a cut"):
        system.restart()


def test_no_map_has_the_number_of_one_that_was_dropped_or_fused():
    truth = walk()
    forward = Script(truth, blind=GAP | {100} | set(range(150, 155)))
    system = dual_of(forward.kind(), Script(truth).kind())
    begun = [e.map_id for e in system.events if e.kind == "reinit_start"]
    assert begun == sorted(set(begun)) and len(begun) == 3
    assert told(system).count("fusion") == 2 and system.maps() == [0]
