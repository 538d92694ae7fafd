"""Dual-SLAM where a recovery fails: it says why, leaves no trace, and both maps stay whole."""

from dataclasses import replace

import numpy as np
import pytest
from dual_scenes import MENDED, RECOVERY_ONLY, STEP_M, dual, of, with_threads
from slam_scenes import blanked, errors_m, feed, kinds, rms, toy

from slam.core.events import TrackingState
from slam.dual.recovery.interface import RecoveryConfig, RecoveryCost, RecoveryResult
from slam.dual.recovery.orb import OrbRecovery
from slam.dual.recovery.registry import ThreadSpec
from slam.map.invariants import check_map


def same_map(m, arrays):
    """Whether a map still has the arrays of a snapshot, up to spare room."""
    return all(
        x[tuple(slice(s) for s in y.shape)].tobytes() == y.tobytes()
        for x, y in zip(m.arrays, arrays, strict=True)
    )


@pytest.fixture(scope="module")
def elsewhere():
    """After the blank frames the camera stands in front of another scene."""
    (here, stamps_s, T_world_cam), (there, _, _) = toy(130, 0, STEP_M), toy(130, 7, STEP_M)
    images = blanked([*here[:56], *there[56:]], range(50, 56))
    system = dual()
    results = feed(system, images[:51], stamps_s[:51])
    snapshot = system.map(0).copy().arrays
    path = system.trajectories()[0]
    results += feed(system, images[51:], stamps_s[51:])
    return system, results, T_world_cam, snapshot, path


def test_a_break_with_nothing_in_common_fails_for_a_reason(elsewhere):
    system, _, _, _, _ = elsewhere
    assert kinds(system) == ["initialized", *MENDED[:-1]]
    end = of(system, "recovery_end")[0]
    assert not end.success
    assert end.stage in ("propagation", "overlap") and end.reason
    assert end.frames_passed_over > 10
    assert of(system, "fusion") == []


def test_both_maps_are_then_kept_whole(elsewhere):
    system, results, T_world_cam, snapshot, path = elsewhere
    assert sorted(system.maps()) == [0, 1] and system.current_map_id == 1
    assert same_map(system.map(0), snapshot)
    paths = {p.map_id: p for p in system.trajectories()}
    assert [p.map_id for p in system.trajectories()] == system.maps() == [1, 0]
    assert paths[0].T_map_cam.tobytes() == path.T_map_cam.tobytes()
    assert paths[0].frames.max() == 49 and paths[1].frames.min() >= 56
    assert results[-1].state is TrackingState.TRACKING and results[-1].map_id == 1
    for p in paths.values():
        assert rms(errors_m(p, T_world_cam)[0]) < 0.03


def test_the_way_back_has_a_limit():
    """A run of unusable frames longer than may be passed over ends the recovery."""
    images, stamps_s, _ = toy(110, 0, STEP_M)
    system = dual(replace(RECOVERY_ONLY, threads=(ThreadSpec("orb", 0, RecoveryConfig(max_unusable_s=0.1)),)))
    feed(system, blanked(images, range(50, 56)), stamps_s)
    end = of(system, "recovery_end")[0]
    assert (end.success, end.stage) == (False, "propagation")
    assert end.reason == "too_few_matches_with_last_frame"
    assert sorted(system.maps()) == [0, 1]


def test_a_map_out_of_reach_of_the_buffer_is_not_sought():
    """While the system waits for a new map the buffer grows, but no farther than its cap."""
    images, stamps_s, _ = toy(150, 0, STEP_M)
    system = dual(replace(RECOVERY_ONLY, buffer_s=0.5, buffer_cap_s=0.5))
    feed(system, blanked(images, range(50, 80)), stamps_s, check=False)
    (end,) = of(system, "recovery_end")
    assert (end.success, end.stage, end.reason) == (False, "overlap", "buffer_exceeded")
    assert "fusion" not in kinds(system)
    assert sorted(system.maps()) == [0, 1]
    grown = dual(replace(RECOVERY_ONLY, buffer_s=1.0, buffer_cap_s=10.0))
    feed(grown, blanked(images, range(50, 80)), stamps_s, check=False)
    assert of(grown, "recovery_start")[0].buffered_frames > 30


@pytest.mark.slow
def test_after_a_failed_recovery_the_next_breakage_has_another_chance(elsewhere):
    """The second scene's map breaks in turn: it is saved, and met by the third map."""
    (here, stamps_s, _), (there, _, _) = toy(190, 0, STEP_M), toy(190, 7, STEP_M)
    images = blanked([*here[:56], *there[56:]], range(50, 56), range(125, 131))
    system = dual()
    feed(system, images, stamps_s, check=False)
    ends = of(system, "recovery_end")
    assert [e.success for e in ends] == [False, True]
    assert of(system, "fusion")[0].old_map_id == 1
    assert sorted(system.maps()) == [0, 1]
    for map_id in system.maps():
        check_map(system.map(map_id))


# -- recovery threads ----------------------------------------------------------------------------------------


class Failing:
    """A recovery thread that spoils all that it is given to extend, and fails."""

    name = "failing"
    needs_images = False
    cost = RecoveryCost(0.0, 0.0, 0.0)

    def __init__(self, spoil):
        self.spoil = spoil

    def run(self, task):
        if self.spoil:
            task.new_map.transform(3.0, np.eye(3), np.ones(3))
            task.first.point[:] = -1
            task.first.T_cam_map[:] = np.nan
        return RecoveryResult(task.new_map, stage="propagation", reason="made_up")


def test_a_failed_thread_leaves_no_trace():
    paths = [with_threads(100, [range(50, 56)], [Failing(spoil)]).trajectories() for spoil in (True, False)]
    assert len(paths[0]) == 2
    for spoilt, clean in zip(*paths, strict=True):
        assert spoilt.map_id == clean.map_id
        assert spoilt.T_map_cam.tobytes() == clean.T_map_cam.tobytes()


def test_threads_run_in_order_until_one_succeeds():
    system = with_threads(100, [range(50, 56)], [Failing(True), OrbRecovery(RecoveryConfig()), Failing(True)])
    ends = [(e.thread, e.method, e.success, e.reason) for e in of(system, "recovery_end")]
    assert ends == [(1, "failing", False, "made_up"), (2, "orb", True, "")]
    assert [e.thread for e in of(system, "recovery_start")] == [1, 2]
    assert system.maps() == [0]
