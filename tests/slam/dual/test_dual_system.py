"""Dual-SLAM over whole sequences: it ends with one map where the base is lost."""

import json
from dataclasses import replace

import numpy as np
import pytest
from dual_scenes import CONFIG, RECOVERED, RECOVERY_ONLY, STEP_M, of, play, scale_between, with_threads
from slam_scenes import accuse, blanked, check_maps, errors_m, feed, kinds, rms, toy

from dslab.slam.core.events import TrackingState
from dslab.slam.dual.dual_slam import DualSlam
from dslab.slam.dual.recovery.interface import RecoveryConfig
from dslab.slam.dual.recovery.orb import OrbRecovery
from dslab.slam.engine import SlamEngine
from dslab.slam.factory import build_system
from dslab.slam.toy_sequence import CAMERA

# -- one breakage --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recovered():
    """Six blank frames in the middle."""
    return play(130, range(50, 56))


def test_a_breakage_ends_in_one_fused_map(recovered):
    system, results, T_world_cam = recovered
    assert kinds(system) == ["initialized", *RECOVERED]
    assert system.maps() == [0] and system.current_map_id == 0
    assert results[-1].state is TrackingState.TRACKING and results[-1].map_id == 0
    (path,) = system.trajectories()
    assert path.frames[0] < 5 and path.frames[-1] == 129
    errors, _ = errors_m(path, T_world_cam)
    # Of a path of 6.5 m.
    assert rms(errors) < 0.04 and errors.max() < 0.12


def test_the_base_is_lost_and_identical_up_to_the_breakage(recovered):
    images, stamps_s, _ = toy(130, 0, STEP_M)
    system = build_system("base", CAMERA, 0, CONFIG)
    results = feed(system, blanked(images[:54], range(50, 54)), stamps_s[:54])
    assert kinds(system) == ["initialized", "breakage"]
    assert results[-1].state is TrackingState.RELOCALIZING
    assert system.trajectories()[0].frames[-1] == 49
    assert [e.record() for e in system.events] == [e.record() for e in recovered[0].events[:2]]
    for r, q in zip(recovered[1][:50], results[:50], strict=True):
        assert (r.state, r.inliers, r.is_keyframe) == (q.state, q.inliers, q.is_keyframe)
        assert r.T_map_cam is None or r.T_map_cam.tobytes() == q.T_map_cam.tobytes()


def test_both_sides_of_the_breakage_have_one_scale(recovered):
    system, _, T_world_cam = recovered
    (path,) = system.trajectories()
    before, after = (scale_between(path, T_world_cam, *side) for side in ((0, 49), (56, 129)))
    assert before / after == pytest.approx(1, abs=0.05)


def test_the_events_describe_the_recovery(recovered):
    system, _, _ = recovered
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
    assert 40 <= fusion.inliers <= end.inliers
    # Both maps were initialized with unit median depth of a similar scene.
    assert fusion.scale == pytest.approx(1, abs=0.2)
    for event in system.events:
        record = event.record()
        assert json.loads(json.dumps(record)) == record
        assert not any(isinstance(value, list | tuple | dict) for value in record.values())
    assert len(end.placed) >= system.dual.start_keyframes


def test_recovery_starts_at_the_required_number_of_keyframes(recovered):
    system, results, _ = recovered
    start = of(system, "recovery_start")[0].frame
    made = [r.frame for r in results if r.is_keyframe and 56 <= r.frame <= start]
    # The first keyframe is the reference frame of the initialisation, declared with the second.
    assert len(made) + 1 == system.dual.start_keyframes


def test_tracking_continues_in_the_old_frame_and_scale(recovered):
    """Poses from the frame of the fusion on are close to the final ones."""
    system, results, _ = recovered
    (path,) = system.trajectories()
    at = {int(f): T for f, T in zip(path.frames, path.T_map_cam, strict=True)}
    fused = of(system, "fusion")[0].frame
    assert [r.map_id for r in results[fused - 1 :]] == [1, *[0] * (130 - fused)]
    for r in results[fused:]:
        assert np.linalg.norm(r.T_map_cam[:3, 3] - at[r.frame][:3, 3]) < 0.02
    steps = np.diff([r.T_map_cam[:3, 3] for r in results[fused:]], axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    assert lengths.max() < 2 * np.median(lengths)


def test_old_keyframes_younger_than_the_seam_are_culled(recovered):
    system, _, _ = recovered
    m = system.current_map
    frames = np.array([m.frame_index(int(k)) for k in m.keyframes()])
    parents = [k for k in range(m.n_keyframes) if m.parent(k) < 0]
    assert parents == [0]
    assert (frames < 50).any() and (frames > 56).any()
    assert len(m.keyframes()) < m.n_keyframes
    # The frame of the alignment is a keyframe of both maps, and one pose of the trajectory.
    (path,) = system.keyframe_trajectories()
    assert path.frames.tolist() == sorted(set(frames.tolist()))


def test_settings_include_those_of_recovery(recovered):
    settings = json.loads(json.dumps(recovered[0].settings))
    assert settings["dual"]["buffer_s"] == 10.0
    assert settings["dual"]["recovery_threads"][0]["kind"] == "orb"
    assert (
        settings["tracking"]
        == json.loads(json.dumps(build_system("base", CAMERA, 0, CONFIG).settings))["tracking"]
    )


def rescaled():
    """A system whose second map has 0.4 of the scale."""
    system = DualSlam(CAMERA, 0, CONFIG, RECOVERY_ONLY)
    start = system.engine._start_map

    def start_rescaled(initial):
        if initial.map.map_id == 1:
            initial.map.transform(0.4, np.eye(3), np.zeros(3))
        start(initial)

    system.engine._start_map = start_rescaled
    return system


@pytest.mark.slow
def test_maps_of_different_scale_are_fused_to_one_scale():
    """Map, frames tracked forward and backward and motion model are rescaled.

    A second blank delays the new map; the frames before it are covered backward.
    """
    images, stamps_s, T_world_cam = toy(130, 0, STEP_M)
    images = blanked(images, range(50, 56), range(58, 60))
    system = rescaled()
    results, fused, step = [], -1, np.nan
    for image, stamp_s in zip(images, stamps_s, strict=True):
        results.append(system.process(image, stamp_s))
        if fused < 0 and of(system, "fusion"):
            fused = len(results) - 1
            velocity = system.tracker.velocity
            assert velocity is not None
            step = np.linalg.norm(velocity[:3, 3])
    assert kinds(system) == ["initialized", *RECOVERED]
    assert of(system, "fusion")[0].scale == pytest.approx(1 / 0.4, rel=0.15)
    assert of(system, "reinit_done")[0].frame > 60
    assert of(system, "recovery_end")[0].frames_passed_over == 8
    check_maps(system)
    (path,) = system.trajectories()
    errors, metres = errors_m(path, T_world_cam)
    assert {56, 57} <= set(path.frames.tolist())
    assert not {*range(50, 56), 58, 59} & set(path.frames.tolist())
    assert errors.max() < 0.12
    before, after = (scale_between(path, T_world_cam, *side) for side in ((0, 49), (60, 129)))
    assert before / after == pytest.approx(1, abs=0.05)
    assert step * metres == pytest.approx(STEP_M, rel=0.3)
    at = dict(zip(path.frames.tolist(), path.T_map_cam, strict=True))
    for r in results[fused:]:
        assert np.linalg.norm(r.T_map_cam[:3, 3] - at[r.frame][:3, 3]) < 0.02


class PassingOver(OrbRecovery):
    """The ORB recovery thread, which gives no pose to the last frames before the breakage."""

    def run(self, task):
        return super().run(replace(task, backward=[f for f in task.backward if f.index not in range(40, 50)]))


@pytest.mark.slow
def test_poses_behind_the_seam_that_recovery_does_not_renew_are_withdrawn():
    system = with_threads(130, [range(50, 56)], [PassingOver()])
    assert kinds(system) == ["initialized", *RECOVERED[:-1], "poses_withdrawn", "fusion"]
    (gone,) = of(system, "poses_withdrawn")
    assert (gone.map_id, gone.reason, gone.last_frame) == (0, "passed_over_by_recovery", 49)
    assert 35 <= gone.first_frame < 49 and gone.frames == 50 - gone.first_frame
    (path,) = system.trajectories()
    missing = [*range(gone.first_frame, 56)]
    assert set(missing).isdisjoint(path.frames)
    assert set(range(path.frames[0], 130)) - set(missing) <= set(path.frames)
    assert gone.keyframes > 0 and set(missing).isdisjoint(system.keyframe_trajectories()[0].frames)


# -- two breakages -------------------------------------------------------------------------------------------


class Recording(OrbRecovery):
    """The ORB recovery thread, which records its tasks."""

    def __init__(self):
        super().__init__(RecoveryConfig())
        self.tasks = []

    def run(self, task):
        backward = list(task.backward)
        self.tasks.append((replace(task, new_map=task.new_map.copy()), [f.index for f in backward]))
        return super().run(replace(task, backward=backward))


@pytest.mark.slow
def test_two_breakages_in_a_row_are_both_recovered():
    thread = Recording()
    system = with_threads(185, [range(50, 56), range(120, 126)], [thread])
    T_world_cam = toy(185, 0, STEP_M)[2]
    assert kinds(system) == ["initialized", *RECOVERED, *RECOVERED]
    assert system.maps() == [0]
    (path,) = system.trajectories()
    assert rms(errors_m(path, T_world_cam)[0]) < 0.05
    scales = [scale_between(path, T_world_cam, *part) for part in ((0, 49), (56, 119), (126, 184))]
    assert max(scales) / min(scales) < 1.05
    assert [e.map_id for e in of(system, "reinit_done")] == [1, 2]
    assert [[m.map_id for m in task.old_maps] for task, _ in thread.tasks] == [[0], [0]]
    for (task, seen), metres in zip(thread.tasks, scales[1:], strict=True):
        # Backward from the new map's first frame; the motion of one frame backward is to the left.
        first = task.first.features.index
        assert seen == list(range(first - 1, seen[-1] - 1, -1)) and seen[-1] < 50
        assert task.new_map.frame_index(0) == first
        assert task.step[0, 3] * metres == pytest.approx(STEP_M, rel=0.4)


@pytest.mark.slow
def test_a_new_map_that_breaks_before_its_recovery_is_dropped():
    """The next map's recovery then reaches the first map, over the frames of both."""
    system, _, T_world_cam = play(140, range(50, 56), range(66, 69))
    assert kinds(system) == [
        "initialized", "breakage", "map_saved", "reinit_start", "initialized", "reinit_done",
        "breakage", "map_dropped", "reinit_start", *RECOVERED[3:],
    ]  # fmt: skip
    dropped = of(system, "map_dropped")[0]
    assert (dropped.map_id, dropped.frame, dropped.reason) == (1, 66, "broke_before_recovery")
    end = of(system, "recovery_end")[0]
    assert (end.map_id, end.old_map_id, end.success) == (2, 0, True)
    assert end.frames_passed_over == 9
    assert system.maps() == [0]
    (path,) = system.trajectories()
    # The dropped map's frames are tracked again, backward.
    assert set(range(61, 66)) <= set(path.frames.tolist())
    assert rms(errors_m(path, T_world_cam)[0]) < 0.05
    scales = [scale_between(path, T_world_cam, *part) for part in ((0, 49), (69, 139))]
    assert max(scales) / min(scales) < 1.05


def test_a_first_map_with_too_few_keyframes_is_dropped_as_in_the_base():
    system, _, _ = play(45, range(7, 9))
    assert kinds(system) == ["initialized", "breakage", "map_dropped", "reinit_start", *RECOVERED[3:5]]
    assert of(system, "map_dropped")[0].reason == "too_few_keyframes"
    assert system.maps() == [1]


@pytest.mark.slow
def test_a_map_begun_from_smeared_frames_is_dropped_before_its_recovery(monkeypatch):
    """The frames to the 70th do not fit; the map that is begun then is recovered from, over all of them."""
    track = SlamEngine.track

    def smeared(engine, frame):
        outcome, is_keyframe = track(engine, frame)
        frame.noise = 2.0 if 56 <= frame.features.index < 70 else 1.0
        return outcome, is_keyframe

    monkeypatch.setattr(SlamEngine, "track", smeared)
    system, _, T_world_cam = play(140, range(50, 56))
    again = ["map_dropped", "reinit_start", "initialized", "reinit_done"]
    found = kinds(system)
    assert found[:6] == ["initialized", *RECOVERED[:5]]
    assert found[6:10] == again and found[-3:] == RECOVERED[-3:]
    dropped = of(system, "map_dropped")
    assert {e.reason for e in dropped} == {"smeared"} and dropped[-1].frame < 75
    assert of(system, "recovery_start")[0].map_id == dropped[-1].map_id + 1
    assert system.maps() == [0]
    (path,) = system.trajectories()
    assert rms(errors_m(path, T_world_cam)[0]) < 0.05


@pytest.mark.parametrize(("at", "cancelled"), [(62, 0), (69, 1)])
@pytest.mark.slow
def test_the_map_after_one_begun_from_the_wrong_motion_is_recovered_from(monkeypatch, at, cancelled):
    """It is found wrong before its own recovery starts, or while it runs."""
    accuse(monkeypatch, range(50, 62), at)
    system, _, T_world_cam = play(130, range(50, 56))
    check_maps(system)
    found = kinds(system)
    again = ["reinit_start", "initialized", "reinit_done", *RECOVERED[-3:]]
    assert [k for k in found[6:] if k != "map_dropped"][-6:] == again
    assert [(e.frame, e.map_id, e.reason) for e in of(system, "map_dropped")] == [(at, 1, "second_motion")]
    assert sum(e.reason == "map_dropped" for e in of(system, "recovery_end")) == cancelled
    assert system.maps() == [0]
    (path,) = system.trajectories()
    assert rms(errors_m(path, T_world_cam)[0]) < 0.05


@pytest.mark.slow
def test_a_map_joined_before_its_start_was_found_wrong_is_kept(monkeypatch):
    accuse(monkeypatch, range(50, 62), at=100)
    system, _, _ = play(110, range(50, 56))
    assert kinds(system) == ["initialized", *RECOVERED] and system.maps() == [0]
