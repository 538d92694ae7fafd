"""Dual-SLAM over whole sequences: one map in the end where the base is lost, or two maps and a reason."""

import json
from dataclasses import replace

import numpy as np
import pytest
from slam_scenes import blanked, errors_m, feed, kinds, rms, toy

from slam.dual.orb_thread import OrbRecovery
from slam.dual.recovery import RecoveryResult
from slam.dual.supervisor import DualConfig, DualSlam
from slam.events import TrackingState
from slam.optimization.sim3 import horn_sim3
from slam.results import MapTrajectory
from slam.system import build_system, default_config
from slam.warmup import CAMERA

STEP_M = 0.05
MENDED = ["breakage", "map_saved", "reinit_start", "initialized", "reinit_done", "recovery_start"]
MENDED += ["recovery_end", "fusion"]


# The sequences are short: a map of a second and a half is worth keeping.
CONFIG = replace(default_config(CAMERA), min_map_keyframes=3)


def dual(config=None):
    return DualSlam(CAMERA, 0, CONFIG, config)


def play(count, *spans):
    """A toy sequence with blank spans: the system, its answers, the truth."""
    images, stamps_s, T_world_cam = toy(count, 0, STEP_M)
    system = dual()
    return system, feed(system, blanked(images, *spans), stamps_s), T_world_cam


def of(system, kind):
    return [e for e in system.events if e.kind == kind]


def scale_between(path: MapTrajectory, T_world_cam, first, last):
    """Metres per map unit over a stretch of frames."""
    here = (path.frames >= first) & (path.frames <= last)
    assert here.sum() > 20
    truth = T_world_cam[path.frames[here], :3, 3]
    return horn_sim3(truth, path.T_map_cam[here, :3, 3])[0]


def same_map(m, arrays):
    """Whether a map still has the arrays of a snapshot, up to spare room."""
    return all(
        x[tuple(slice(s) for s in y.shape)].tobytes() == y.tobytes()
        for x, y in zip(m.arrays, arrays, strict=True)
    )


# -- one breakage --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def mended():
    """Six blank frames in the middle."""
    return play(130, range(50, 56))


def test_it_ends_in_one_fused_map(mended):
    system, results, T_world_cam = mended
    assert kinds(system) == ["initialized", *MENDED]
    assert system.maps() == [0] and system.current_map_id == 0
    assert results[-1].state is TrackingState.TRACKING and results[-1].map_id == 0
    (path,) = system.trajectories()
    assert path.frames[0] < 5 and path.frames[-1] == 129
    errors, _ = errors_m(path, T_world_cam)
    # Of a path of 6.5 m.
    assert rms(errors) < 0.04 and errors.max() < 0.12


def test_the_base_does_not_and_up_to_the_breakage_they_are_one(mended):
    images, stamps_s, _ = toy(130, 0, STEP_M)
    system = build_system("base", CAMERA, 0, CONFIG)
    results = feed(system, blanked(images[:75], range(50, 56)), stamps_s[:75])
    assert kinds(system) == ["initialized", "breakage"]
    assert results[-1].state is TrackingState.LOST
    assert system.trajectories()[0].frames[-1] == 49
    assert [e.record() for e in system.events] == [e.record() for e in mended[0].events[:2]]
    for r, q in zip(mended[1][:50], results[:50], strict=True):
        assert (r.state, r.inliers, r.is_keyframe) == (q.state, q.inliers, q.is_keyframe)
        assert r.T_map_cam is None or r.T_map_cam.tobytes() == q.T_map_cam.tobytes()


def test_both_sides_of_the_breakage_have_one_scale(mended):
    system, _, T_world_cam = mended
    (path,) = system.trajectories()
    before, after = (scale_between(path, T_world_cam, *side) for side in ((0, 49), (56, 129)))
    assert before / after == pytest.approx(1, abs=0.05)


def test_the_events_tell_what_happened(mended):
    system, _, _ = mended
    by_kind = {e.kind: e for e in system.events}
    broken, saved = by_kind["breakage"], by_kind["map_saved"]
    assert (broken.frame, broken.map_id, saved.frame, saved.map_id) == (50, 0, 50, 0)
    assert broken.reason == "too_few_matches_with_last_frame"
    assert saved.keyframes > system.config.min_map_keyframes and saved.points > 200
    assert (by_kind["reinit_start"].frame, by_kind["reinit_start"].map_id) == (50, 1)
    done, start, end = by_kind["reinit_done"], by_kind["recovery_start"], by_kind["recovery_end"]
    assert done.map_id == 1 and done.frames_taken == done.frame - 50 > 5
    assert (start.thread, start.method, start.old_map_id, start.map_id) == (1, "orb", 0, 1)
    assert 50 <= start.buffered_frames <= done.frame
    assert end.success and (end.stage, end.reason) == ("", "")
    assert 6 <= end.frames_passed_over < end.frames_covered <= start.buffered_frames
    assert end.cpu_ms > 0
    fusion = by_kind["fusion"]
    assert fusion.accepted and (fusion.old_map_id, fusion.map_id) == (0, 0)
    assert fusion.inliers == end.inliers >= 40
    # Both maps began with unit median depth of much the same scene.
    assert fusion.scale == pytest.approx(1, abs=0.2)
    for event in system.events:
        record = event.record()
        assert json.loads(json.dumps(record)) == record


def test_recovery_waits_for_a_sound_new_map(mended):
    system, results, _ = mended
    start = of(system, "recovery_start")[0].frame
    made = [r.frame for r in results if r.is_keyframe and 56 <= r.frame <= start]
    # The first keyframe is the reference frame of the initialisation, declared with the second.
    assert len(made) + 1 == system.dual.start_keyframes


def test_tracking_goes_on_in_the_old_frame_and_scale(mended):
    """The pose of the frame at which the maps are fused, and of those after it, is the final one nearly."""
    system, results, _ = mended
    (path,) = system.trajectories()
    at = {int(f): T for f, T in zip(path.frames, path.T_map_cam, strict=True)}
    fused = of(system, "fusion")[0].frame
    assert [r.map_id for r in results[fused - 1 :]] == [1, *[0] * (130 - fused)]
    for r in results[fused:]:
        assert np.linalg.norm(r.T_map_cam[:3, 3] - at[r.frame][:3, 3]) < 0.02
    steps = np.diff([r.T_map_cam[:3, 3] for r in results[fused:]], axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    assert lengths.max() < 2 * np.median(lengths)


def test_old_keyframes_younger_than_the_seam_are_gone(mended):
    system, _, _ = mended
    m = system.current_map
    frames = np.array([m.frame_index(int(k)) for k in m.keyframes()])
    parents = [k for k in range(m.n_keyframes) if m.parent(k) < 0]
    assert parents == [0]
    assert (frames < 50).any() and (frames > 56).any()
    assert len(m.keyframes()) < m.n_keyframes
    # The frame where the maps met is a keyframe of both, and one pose of the path.
    (path,) = system.keyframe_trajectories()
    assert path.frames.tolist() == sorted(set(frames.tolist()))


def test_settings_in_force_include_those_of_recovery(mended):
    settings = json.loads(json.dumps(mended[0].settings))
    assert settings["dual"]["buffer_s"] == 10.0
    assert settings["dual"]["recovery"]["fusion"]["confirmations"] == 2
    assert (
        settings["tracking"]
        == json.loads(json.dumps(build_system("base", CAMERA, 0, CONFIG).settings))["tracking"]
    )


class Rescaled(DualSlam):
    """A system whose second map comes out at 0.4 of the scale, as in front of a scene of other depth."""

    def _start_map(self, initial):
        if self.current_map_id == 1:
            initial.map.transform(0.4, np.eye(3), np.zeros(3))
        super()._start_map(initial)


def test_maps_of_different_scale_become_one_scale():
    """All that is carried over is rescaled: map, frames tracked forward and backward, motion model."""
    images, stamps_s, T_world_cam = toy(130, 0, STEP_M)
    images = blanked(images, range(50, 56), range(58, 60))
    system = Rescaled(CAMERA, 0, CONFIG)
    results, fused = [], None
    for image, stamp_s in zip(images, stamps_s, strict=True):
        results += feed(system, [image], [stamp_s])
        if fused is None and of(system, "fusion"):
            fused = len(results) - 1
            step = np.linalg.norm(system.tracker.velocity[:3, 3])
    assert of(system, "fusion")[0].scale == pytest.approx(1 / 0.4, rel=0.15)
    (path,) = system.trajectories()
    errors, metres = errors_m(path, T_world_cam)
    assert {56, 57} <= set(path.frames.tolist())
    assert errors.max() < 0.12
    before, after = (scale_between(path, T_world_cam, *side) for side in ((0, 49), (60, 129)))
    assert before / after == pytest.approx(1, abs=0.05)
    assert step * metres == pytest.approx(STEP_M, rel=0.3)
    at = dict(zip(path.frames.tolist(), path.T_map_cam, strict=True))
    for r in results[fused:]:
        assert np.linalg.norm(r.T_map_cam[:3, 3] - at[r.frame][:3, 3]) < 0.02


# -- recovery threads ----------------------------------------------------------------------------------------


class Failing:
    """A recovery thread that spoils all that it is given to extend, and fails."""

    name = "failing"

    def __init__(self, spoil):
        self.spoil = spoil

    def run(self, task):
        if self.spoil:
            task.new_map.transform(3.0, np.eye(3), np.ones(3))
            task.first.point[:] = -1
            task.first.T_cam_map[:] = np.nan
        return RecoveryResult(task.new_map, stage="propagation", reason="made_up")


class Recording(OrbRecovery):
    """The recovery thread, which keeps what it was given."""

    def __init__(self):
        super().__init__(DualConfig().recovery)
        self.tasks = []

    def run(self, task):
        backward = list(task.backward)
        self.tasks.append((replace(task, new_map=task.new_map.copy()), [f.index for f in backward]))
        return super().run(replace(task, backward=backward))


def with_threads(count, spans, threads):
    images, stamps_s, _ = toy(count, 0, STEP_M)
    system = dual()
    system._threads = threads
    feed(system, blanked(images, *spans), stamps_s, check=False)
    for map_id in system.maps():
        system.map(map_id).check()
    return system


def test_a_failed_thread_leaves_no_trace():
    paths = [with_threads(100, [range(50, 56)], [Failing(spoil)]).trajectories() for spoil in (True, False)]
    assert len(paths[0]) == 2
    for spoilt, clean in zip(*paths, strict=True):
        assert spoilt.map_id == clean.map_id
        assert spoilt.T_map_cam.tobytes() == clean.T_map_cam.tobytes()


def test_threads_run_in_order_until_one_succeeds():
    system = with_threads(
        100, [range(50, 56)], [Failing(True), OrbRecovery(DualConfig().recovery), Failing(True)]
    )
    ends = [(e.thread, e.method, e.success, e.reason) for e in of(system, "recovery_end")]
    assert ends == [(1, "failing", False, "made_up"), (2, "orb", True, "")]
    assert [e.thread for e in of(system, "recovery_start")] == [1, 2]
    assert system.maps() == [0]


# -- more than one -------------------------------------------------------------------------------------------


def test_two_breakages_in_a_row_are_both_mended():
    thread = Recording()
    system = with_threads(185, [range(50, 56), range(120, 126)], [thread])
    T_world_cam = toy(185, 0, STEP_M)[2]
    assert kinds(system) == ["initialized", *MENDED, *MENDED]
    assert system.maps() == [0]
    (path,) = system.trajectories()
    assert rms(errors_m(path, T_world_cam)[0]) < 0.05
    scales = [scale_between(path, T_world_cam, *part) for part in ((0, 49), (56, 119), (126, 184))]
    assert max(scales) / min(scales) < 1.05
    # A map's number is free again once it is fused, but never two maps have it.
    assert [e.map_id for e in of(system, "reinit_done")] == [1, 1]
    assert [[m.map_id for m in task.old_maps] for task, _ in thread.tasks] == [[0], [0]]
    for (task, seen), metres in zip(thread.tasks, scales[1:], strict=True):
        # From the new map's first frame backward, by the motion of a single frame, which is to the left.
        first = task.first.features.index
        assert seen == list(range(first - 1, seen[-1] - 1, -1)) and seen[-1] < 50
        assert task.new_map.frame_index(0) == first
        assert task.step[0, 3] * metres == pytest.approx(STEP_M, rel=0.4)


def test_a_breakage_while_initialising_is_only_a_delay():
    """The frames between it and the new map are covered backward, each with a pose of its own."""
    system, _, T_world_cam = play(130, range(50, 56), range(58, 60))
    assert kinds(system) == ["initialized", *MENDED]
    assert of(system, "reinit_done")[0].frame > 60
    assert of(system, "recovery_end")[0].frames_passed_over == 8
    (path,) = system.trajectories()
    assert {56, 57} <= set(path.frames.tolist())
    assert not {*range(50, 56), 58, 59} & set(path.frames.tolist())
    errors, _ = errors_m(path, T_world_cam)
    assert errors.max() < 0.12


def test_a_new_map_that_breaks_before_its_recovery_is_dropped_and_the_first_one_met():
    system, _, T_world_cam = play(140, range(50, 56), range(66, 69))
    assert kinds(system) == [
        "initialized", "breakage", "map_saved", "reinit_start", "initialized", "reinit_done",
        "breakage", "map_dropped", "reinit_start", *MENDED[3:],
    ]  # fmt: skip
    dropped = of(system, "map_dropped")[0]
    assert (dropped.map_id, dropped.frame, dropped.reason) == (1, 66, "broke_before_recovery")
    end = of(system, "recovery_end")[0]
    assert (end.map_id, end.old_map_id, end.success) == (2, 0, True)
    assert end.frames_passed_over == 9
    assert system.maps() == [0]
    (path,) = system.trajectories()
    # What the dropped map had tracked is tracked again, backward.
    assert set(range(61, 66)) <= set(path.frames.tolist())
    assert rms(errors_m(path, T_world_cam)[0]) < 0.05
    scales = [scale_between(path, T_world_cam, *part) for part in ((0, 49), (69, 139))]
    assert max(scales) / min(scales) < 1.05


def test_a_first_map_too_young_is_dropped_as_in_the_base():
    system, _, _ = play(45, range(12, 14))
    assert kinds(system) == ["initialized", "breakage", "map_dropped", "reinit_start", "initialized"]
    assert of(system, "map_dropped")[0].reason == "too_few_keyframes"
    assert system.maps() == [1]


# -- failure -------------------------------------------------------------------------------------------------


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
    config = DualConfig()
    system = dual(replace(config, recovery=replace(config.recovery, max_unusable_s=0.1)))
    feed(system, blanked(images, range(50, 56)), stamps_s)
    end = of(system, "recovery_end")[0]
    assert (end.success, end.stage) == (False, "propagation")
    assert end.reason == "too_few_matches_with_last_frame"
    assert sorted(system.maps()) == [0, 1]


def test_a_map_out_of_reach_of_the_buffer_is_not_sought():
    """While the system waits for a new map the buffer grows, but no farther than its cap."""
    images, stamps_s, _ = toy(150, 0, STEP_M)
    system = dual(DualConfig(buffer_s=0.5, buffer_cap_s=0.5))
    feed(system, blanked(images, range(50, 80)), stamps_s, check=False)
    assert "recovery_start" not in kinds(system) and "fusion" not in kinds(system)
    assert sorted(system.maps()) == [0, 1]
    grown = dual(DualConfig(buffer_s=1.0, buffer_cap_s=10.0))
    feed(grown, blanked(images, range(50, 80)), stamps_s, check=False)
    assert of(grown, "recovery_start")[0].buffered_frames > 30


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
        system.map(map_id).check()
