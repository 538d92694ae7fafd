"""Dual-SLAM with a failing recovery: it reports why, and both maps stay unchanged."""

from dataclasses import replace

import numpy as np
import pytest
from dual_scenes import RECOVERED, RECOVERY_ONLY, STEP_M, dual, of, with_threads
from recovery_scenes import blind_scene
from slam_scenes import blanked, errors_m, feed, feed_until, fingerprint, kinds, rms, toy

from dslab.slam.core.events import TrackingState
from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryCost, RecoveryResult
from dslab.slam.dual.recovery.orb import OrbRecovery
from dslab.slam.map.invariants import check_map


def same_map(m, arrays):
    """Return True if a map still has the arrays of a snapshot, up to spare capacity."""
    return all(
        x[tuple(slice(s) for s in y.shape)].tobytes() == y.tobytes()
        for x, y in zip(m.arrays, arrays, strict=True)
    )


@pytest.fixture(scope="module")
def elsewhere():
    """After the blank frames the camera sees another scene."""
    (here, stamps_s, T_world_cam), (there, _, _) = toy(120, 0, STEP_M), toy(120, 7, STEP_M)
    images = blanked([*here[:56], *there[56:]], range(50, 56))
    system = dual()
    results = feed(system, images[:51], stamps_s[:51])
    snapshot = system.map(0).copy().arrays
    path = system.trajectories()[0]
    results += feed(system, images[51:], stamps_s[51:])
    return system, results, T_world_cam, snapshot, path


def test_a_recovery_without_overlap_fails_with_a_reason(elsewhere):
    system, _, _, _, _ = elsewhere
    assert kinds(system) == ["initialized", *RECOVERED[:-1]]
    end = of(system, "recovery_end")[0]
    assert not end.success
    assert end.stage in ("propagation", "overlap") and end.reason
    assert end.frames_passed_over > 10
    assert of(system, "fusion") == []
    (failure,) = system.jobs.failures
    assert (failure.new_id, failure.since, failure.reasons) == (1, 50, ((end.stage, end.reason),))


def test_after_a_failed_recovery_both_maps_are_kept(elsewhere):
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


def test_too_many_unusable_frames_end_the_recovery():
    result = blind_scene().run("orb", RecoveryConfig(max_unusable_s=0.1))
    assert (result.success, result.stage) == (False, "propagation")
    assert result.reason == "too_few_matches_with_last_frame"
    assert 4 <= result.frames_passed_over <= 5


@pytest.mark.slow
def test_the_buffer_grows_until_its_cap_and_recovery_fails_beyond_it():
    images, stamps_s, _ = toy(150, 0, STEP_M)
    images = blanked(images, range(50, 72))
    system = dual(replace(RECOVERY_ONLY, buffer_s=0.5, buffer_cap_s=0.5))
    fed = feed_until(system, images, stamps_s, "recovery_end")
    feed(system, images[fed : fed + 2], stamps_s[fed : fed + 2])
    (end,) = of(system, "recovery_end")
    assert (end.success, end.stage, end.reason) == (False, "overlap", "buffer_exceeded")
    assert [f.reasons for f in system.jobs.failures] == [(("overlap", "buffer_exceeded"),)]
    assert "fusion" not in kinds(system)
    assert sorted(system.maps()) == [0, 1]
    grown = dual(replace(RECOVERY_ONLY, buffer_s=0.5, buffer_cap_s=10.0))
    feed_until(grown, images, stamps_s, "recovery_start")
    assert of(grown, "recovery_start")[0].buffered_frames > 15


@pytest.mark.slow
def test_after_a_failed_recovery_the_next_breakage_is_recovered(elsewhere):
    """The second scene's map is saved at a second breakage and fused with the third map."""
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
    """A recovery thread that fails and, on request, corrupts its task first."""

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
        return RecoveryResult(task.new_map, stage="propagation", reason="synthetic")


@pytest.mark.slow
def test_threads_run_until_one_succeeds_and_a_failed_one_leaves_no_trace():
    systems = [
        with_threads(100, [range(50, 56)], [Failing(spoil), OrbRecovery(RecoveryConfig()), Failing(True)])
        for spoil in (True, False)
    ]
    for system in systems:
        ends = [(e.thread, e.method, e.success, e.reason) for e in of(system, "recovery_end")]
        assert ends[:2] == [(1, "failing", False, "synthetic"), (2, "orb", True, "")]
        assert ends[2:] == [(3, "failing", False, "not_needed")]
        assert [e.thread for e in of(system, "recovery_start")] == [1, 2, 3]
        assert system.maps() == [0] and system.jobs.failures == []
    assert fingerprint(systems[0]) == fingerprint(systems[1])
