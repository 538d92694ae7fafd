"""The tracker predicts, falls back and fails with a reason, in both directions of time."""

import numpy as np
import pytest
from slam_scenes import CAMERA, FPS, PointWorld, Sighting, pose_error, rigid, tracked_in, walk

from dslab.slam.core.frame import Frame, FrameFeatures
from dslab.slam.core.timing import StageTimer
from dslab.slam.map.invariants import check_map
from dslab.slam.tracking.config import TrackingConfig
from dslab.slam.tracking.rules import own
from dslab.slam.tracking.tracker import Tracker

LAST = 40


@pytest.fixture(scope="module")
def world():
    return PointWorld(seed=1)


@pytest.fixture(scope="module")
def sightings(world):
    """The frames of a moving camera, with the noise of real features."""
    rng = np.random.default_rng(2)
    return [world.see(i, walk(i), rng, noise_px=0.5, bits=8) for i in range(LAST + 1)]


@pytest.fixture
def known(world, sightings):
    """A new map of the whole path, accurate to a few millimetres, and its points by world point."""
    return world.map_of(sightings[::5], np.random.default_rng(3), noise=0.004)


@pytest.fixture
def no_reference(monkeypatch):
    """Without a prediction nothing is found."""
    monkeypatch.setattr(own, "track_reference_keyframe", lambda *_: False)


def started(known, sighting, velocity=None):
    """A tracker that has just tracked a keyframe's sighting."""
    built, point_of = known
    keyframe = sighting.frame.features.index // 5
    tracker = Tracker(built, TrackingConfig(), StageTimer())
    tracker.start(tracked_in(built, point_of, sighting, keyframe), keyframe, velocity)
    return tracker


def step_between(a: Sighting, b: Sighting):
    return b.T_cam_world @ np.linalg.inv(a.T_cam_world)


def far(outcome_frame, sighting, most_m=0.02, most_deg=0.3):
    distance, angle = pose_error(outcome_frame.T_cam_map, sighting.T_cam_world)
    return distance > most_m or angle > most_deg


def nothing(index):
    """A frame without features."""
    empty = np.empty((0, 2), np.float32)
    cells = np.zeros(41 * 31 + 1, np.int32)
    return Frame(
        FrameFeatures(
            index, index / FPS, empty, empty.astype(float), np.empty(0, np.int32), np.empty(0, np.float32),
            np.empty((0, 4), np.uint64), cells, CAMERA,
        )
    )  # fmt: skip


@pytest.mark.parametrize("order", [range(1, LAST + 1), range(LAST - 1, -1, -1)], ids=["forward", "backward"])
def test_a_walk_is_tracked_in_either_direction_of_time(known, sightings, order):
    start = sightings[order[0] - 1 if order.step > 0 else order[0] + 1]
    tracker = started(known, start)
    _, point_of = known
    for i in order:
        frame = sightings[i].again()
        outcome = tracker.track(frame)
        assert outcome.success and outcome.reason == ""
        assert not far(frame, sightings[i])
        rows = np.flatnonzero(frame.point >= 0)
        assert outcome.inliers == len(rows) <= outcome.matches
        expected = point_of[sightings[i].ids]
        expected[sightings[i].ids < 0] = -1
        assert (frame.point[rows] == expected[rows]).mean() > 0.99
        assert len(rows) > 0.85 * (expected >= 0).sum()
        assert frame.reference_keyframe == pytest.approx(i / 5, abs=3)
    check_map(known[0])


def test_both_directions_of_time_track_equally_well(known, sightings):
    errors = []
    for order in (range(1, LAST + 1), range(LAST - 1, -1, -1)):
        tracker = started(known, sightings[order[0] - order.step])
        poses = []
        for i in order:
            frame = sightings[i].again()
            assert tracker.track(frame).success
            poses.append(pose_error(frame.T_cam_map, sightings[i].T_cam_world))
        errors.append(np.array(poses).mean(0))
    np.testing.assert_allclose(errors[0], errors[1], rtol=0.35)


def test_a_pose_is_kept_relative_to_the_reference_keyframe(known, sightings, no_reference):
    """The last frame follows when mapping moves its reference keyframe."""
    built, _ = known
    tracker = started(known, sightings[0], step_between(sightings[0], sightings[1]))
    for i in (1, 2):
        frame = sightings[i].again()
        tracker.track(frame)
        np.testing.assert_allclose(
            frame.T_cam_reference @ built.T_cam_map(frame.reference_keyframe), frame.T_cam_map, atol=1e-12
        )
    whole = rigid((1.0, -2.0, 0.5), (10, 20, -15))
    built.transform(1.0, whole[:3, :3], whole[:3, 3])
    frame = sightings[3].again()
    assert tracker.track(frame).success
    moved = Sighting(frame, sightings[3].ids, sightings[3].T_cam_world @ np.linalg.inv(whole))
    assert not far(frame, moved)


def test_observed_points_are_counted_as_visible_and_found(known, sightings):
    a = known[0].arrays
    visible, found = a.pt_visible.copy(), a.pt_found.copy()
    frame = sightings[1].again()
    started(known, sightings[0]).track(frame)
    tracked = np.zeros(len(a.pt_found), bool)
    tracked[frame.point[frame.point >= 0]] = True
    np.testing.assert_array_equal(a.pt_found - found, tracked)
    assert (a.pt_visible - visible)[tracked].all()
    assert (a.pt_visible - visible).sum() > tracked.sum()


def test_the_velocity_is_the_last_step(known, sightings):
    tracker = started(known, sightings[0])
    assert tracker.velocity is None
    for i in (1, 2):
        assert tracker.track(sightings[i].again()).success
    assert max(pose_error(tracker.velocity, step_between(sightings[1], sightings[2]))) < 0.2


def test_the_motion_model_finds_a_frame_far_away(known, sightings, no_reference):
    step = step_between(sightings[0], sightings[16])
    frame = sightings[16].again()
    assert started(known, sightings[0], step).track(frame).success
    assert not far(frame, sightings[16])


@pytest.mark.parametrize("velocity", [None, rigid((1.5, 0, 0))], ids=["unknown", "wrong"])
def test_the_reference_keyframe_replaces_the_motion_model(known, sightings, velocity, monkeypatch):
    frame = sightings[8].again()
    assert started(known, sightings[0], velocity).track(frame).success
    assert not far(frame, sightings[8])
    monkeypatch.setattr(own, "track_reference_keyframe", lambda *_: False)
    assert not started(known, sightings[0], velocity).track(sightings[8].again()).success


def test_the_parent_replaces_a_culled_reference_keyframe(known, sightings):
    built, _ = known
    tracker = started(known, sightings[10])
    built.cull_keyframe(2)
    frame = sightings[11].again()
    assert tracker.track(frame).success
    assert not far(frame, sightings[11])
    assert frame.reference_keyframe != 2


def test_another_scene_is_not_tracked_and_changes_nothing(known, sightings):
    foreign = PointWorld(seed=99).see(1, walk(1), np.random.default_rng(0))
    tracker = started(known, sightings[0], np.eye(4))
    last, velocity = tracker.last, tracker.velocity
    outcome = tracker.track(foreign.frame)
    assert not outcome.success and outcome.inliers == 0
    assert outcome.reason == "too_few_matches_with_last_frame"
    assert tracker.last is last and tracker.velocity is velocity
    assert tracker.track(sightings[1].again()).success


def test_a_frame_without_features_is_not_tracked(known, sightings):
    outcome = started(known, sightings[0], np.eye(4)).track(nothing(1))
    assert (outcome.success, outcome.inliers, outcome.matches) == (False, 0, 0)
    assert outcome.reason == "too_few_matches_with_last_frame"


def test_few_points_are_no_pose(known, sightings):
    for count, success in ((11, False), (40, True)):
        whole, f = sightings[1], sightings[1].frame.features
        shown = np.flatnonzero((whole.ids >= 0) & (known[1][whole.ids] >= 0))
        near = known[0].observed_points(0)
        keep = shown[np.isin(known[1][whole.ids[shown]], near)][:: len(shown) // 60][:count]
        rows = np.sort(keep)
        cells = np.searchsorted(rows, f.cell_start).astype(np.int32)
        few = FrameFeatures(
            1, 1 / FPS, f.xy_image[rows], f.xy[rows], f.octave[rows], f.angle_deg[rows],
            f.descriptors[rows], cells, f.camera,
        )  # fmt: skip
        outcome = started(known, sightings[0], step_between(sightings[0], whole)).track(Frame(few))
        assert outcome.success is success
        assert outcome.reason == ("" if success else "too_few_matches_with_last_frame")
        assert not success or outcome.matches >= outcome.inliers > 30


# -- gaps ----------------------------------------------------------------------------------------------------


def track_until(tracker, sightings, stop):
    for i in range(1, stop):
        assert tracker.track(sightings[i].again()).success


@pytest.mark.parametrize("gap", [4, 12])
def test_tracking_resumes_across_a_gap(known, sightings, gap, monkeypatch):
    """The pose is predicted over passed-over frames."""
    carried = started(known, sightings[0])
    track_until(carried, sightings, 8)
    monkeypatch.setattr(own, "track_reference_keyframe", lambda *_: False)
    for i in range(8, 8 + gap):
        assert not carried.track(nothing(i)).success
        carried.pass_over(nothing(i))
    assert not far(carried.last, sightings[7 + gap], most_m=0.1, most_deg=1.5)
    frame = sightings[8 + gap].again()
    assert carried.track(frame).success
    assert not far(frame, sightings[8 + gap])
    after = sightings[9 + gap].again()
    assert carried.track(after).success
    assert not far(after, sightings[9 + gap])


def test_the_velocity_is_kept_over_a_gap(known, sightings):
    """The step over the gap is not used as velocity; the one before the gap is kept."""
    tracker = started(known, sightings[0])
    track_until(tracker, sightings, 8)
    before = np.array(tracker.velocity)
    for i in range(8, 16):
        tracker.pass_over(nothing(i))
    assert tracker.track(sightings[16].again()).success
    np.testing.assert_array_equal(tracker.velocity, before)
    assert tracker.track(sightings[17].again()).success
    assert max(pose_error(tracker.velocity, step_between(sightings[16], sightings[17]))) < 0.2


def test_passing_over_does_not_change_the_tracked_frame(known, sightings):
    """The frame before a gap keeps its own pose; only the tracker's is predicted."""
    tracker = started(known, sightings[0])
    track_until(tracker, sightings, 7)
    frame = sightings[7].again()
    assert tracker.track(frame).success
    T_cam_map, T_cam_reference = frame.T_cam_map.copy(), frame.T_cam_reference.copy()
    for i in range(8, 14):
        tracker.pass_over(nothing(i))
    np.testing.assert_allclose(frame.T_cam_map, T_cam_map, atol=1e-12)
    np.testing.assert_allclose(frame.T_cam_reference, T_cam_reference, atol=1e-12)


def test_passing_over_without_a_velocity_keeps_the_pose(known, sightings):
    tracker = started(known, sightings[0])
    for i in range(1, 5):
        tracker.pass_over(nothing(i))
    frame = sightings[5].again()
    assert tracker.track(frame).success
    assert not far(frame, sightings[5])


# -- keyframes -----------------------------------------------------------------------------------------------


def test_a_new_keyframe_becomes_the_reference_with_its_points(known, sightings):
    built, point_of = known
    tracker = started(known, sightings[0])
    frame = sightings[3].again()
    assert tracker.track(frame).success
    row = built.add_keyframe(tracked_in(built, point_of, sightings[3], 0), 0)
    tracker.keyframe_made(frame, row)
    np.testing.assert_array_equal(frame.point, built.observed_points(row))
    assert frame.reference_keyframe == row
    np.testing.assert_array_equal(frame.T_cam_map, built.T_cam_map(row))
    # A keyframe has just been made: no other is requested at once.
    assert not tracker.wants_keyframe(frame, 0)


def test_tracking_continues_in_a_map_that_has_absorbed_its_own(world, known, sightings):
    """Rows shift, the scale is that of the other map, and the next frame is tracked."""
    built, _ = known
    tracker = started(known, sightings[20])
    for i in (21, 22):
        last = sightings[i].again()
        assert tracker.track(last).success
    other, _ = world.map_of(sightings[:4], np.random.default_rng(4))
    whole = rigid((1.0, 0.3, -0.5), (5, -10, 20))
    built.transform(2.0, whole[:3, :3], whole[:3, 3])
    keyframes, points = other.absorb(built)
    last.reference_keyframe += keyframes
    last.point[last.point >= 0] += points
    last.T_cam_reference[:3, 3] *= 2.0
    assert tracker.velocity is not None
    tracker.velocity[:3, 3] *= 2.0
    tracker.rebase(other, last)
    frame = sightings[23].again()
    assert tracker.track(frame).success
    truth = sightings[23].T_cam_world @ np.linalg.inv(whole)
    truth[:3, 3] = 2 * sightings[23].T_cam_world[:3, 3] - truth[:3, :3] @ whole[:3, 3]
    distance, angle = pose_error(frame.T_cam_map, truth)
    assert distance < 0.04 and angle < 0.3


def test_a_gap_entered_with_a_wrong_pose_is_bridged(known, sightings):
    """The last pose before a gap may be poor, and its prediction far off at the end."""
    turn = rigid(np.zeros(3), rotvec_deg=(0.0, 4.0, 0.0))
    tracker = started(known, sightings[0], turn)
    for i in range(1, 12):
        tracker.pass_over(nothing(i))
    assert far(tracker.last, sightings[11], most_m=0.1, most_deg=20.0)
    frame = sightings[12].again()
    assert tracker.track(frame).success
    assert not far(frame, sightings[12])
