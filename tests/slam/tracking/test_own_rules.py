"""Rules from covariances: windows that grow, a pose that must be known, keyframes by information."""

import numpy as np
import pytest
from slam_scenes import PointWorld, pose_error, rigid, tracked_in, walk

from dslab.slam.core.timing import StageTimer
from dslab.slam.tracking.belief import MotionBelief
from dslab.slam.tracking.config import TrackingConfig
from dslab.slam.tracking.rules import own
from dslab.slam.tracking.rules.own import variance
from dslab.slam.tracking.tracker import Tracker


@pytest.fixture(scope="module")
def world():
    return PointWorld(seed=1)


@pytest.fixture(scope="module")
def sightings(world):
    rng = np.random.default_rng(2)
    return [world.see(i, walk(i), rng, noise_px=0.7, bits=8) for i in range(31)]


@pytest.fixture(autouse=True)
def no_reference(monkeypatch):
    """Without a prediction nothing is found: what is found, the prediction has."""
    monkeypatch.setattr(own, "track_reference_keyframe", lambda *_: False)


def started(world, sightings, at=0):
    known = world.map_of(sightings[::5], np.random.default_rng(3), noise=0.004)
    tracker = Tracker(known[0], TrackingConfig(), StageTimer())
    velocity = sightings[at + 1].T_cam_world @ np.linalg.inv(sightings[at].T_cam_world)
    tracker.start(tracked_in(*known, sightings[at], at // 5), at // 5, velocity)
    return tracker, known[1]


def optimized(tracker, frame):
    inliers, _ = tracker.rules.gate.refine(tracker.map, frame)
    frame.relative = tracker.rules.gate.relative(tracker.map, frame)
    return inliers


def test_a_walk_is_tracked_by_right_matches_and_tells_its_noise(world, sightings):
    tracker, point_of = started(world, sightings)
    for sighting in sightings[1:]:
        frame = sighting.again()
        assert tracker.track(frame).success
        distance, angle = pose_error(frame.T_cam_map, sighting.T_cam_world)
        assert distance < 0.02 and angle < 0.3
        rows = np.flatnonzero(frame.point >= 0)
        assert (point_of[sighting.ids[rows]] == frame.point[rows]).mean() > 0.98
    assert np.sqrt(frame.noise2) == pytest.approx(0.7, abs=0.12)
    assert np.sqrt(tracker.map.noise2) == pytest.approx(0.7, abs=0.12)


def test_a_turn_that_nothing_foretold_is_found_by_wider_windows(world):
    rng = np.random.default_rng(4)
    turn = rigid(rotvec_deg=(0, 6, 0))  # 50 px at once
    views = [world.see(i, walk(i), rng, noise_px=0.5) for i in range(11)]
    tracker, _ = started(world, views)
    turned = world.see(1, turn @ walk(1), rng, noise_px=0.5)
    frame = turned.again()
    assert tracker.track(frame).success and pose_error(frame.T_cam_map, turned.T_cam_world)[1] < 0.3


def test_windows_grow_with_surprise_and_over_a_gap_and_shrink_again():
    belief, exact = MotionBelief(), np.zeros((6, 6))
    before = belief.variance.copy()
    for _ in range(10):
        belief.note(np.eye(4), rigid((0, 0, 0.4), (0, 10, 0)), 2.0)
    surprised = belief.variance
    assert surprised[4] > 10 * before[4] and surprised[2] > 10 * before[2] and surprised[3] < before[3]
    one, four = (np.diag(belief.predicted(exact, steps, 2.0)) for steps in (1, 4))
    assert four / one == pytest.approx(30.0)  # 1 + 4 + 9 + 16
    for _ in range(60):
        belief.note(np.eye(4), np.eye(4), 2.0)
    assert belief.variance[4] < 0.1 * surprised[4]


@pytest.mark.parametrize(
    ("corner", "fault"),
    [((565, 405), "too_few_local_map_inliers"), ((0, 0), "")],
    ids=["one corner", "everywhere"],
)
def test_points_in_a_corner_of_the_image_are_no_pose(world, sightings, corner, fault):
    tracker, point_of = started(world, sightings)
    frame = tracked_in(tracker.map, point_of, sightings[3], 0)
    frame.point[(frame.features.xy < corner).any(1)] = -1
    inliers = optimized(tracker, frame)
    assert tracker.rules.loss.fault(tracker, frame, tracker.last, inliers) == fault


def test_a_pose_that_its_points_leave_open_is_lost_however_many_they_are(world, sightings):
    tracker, point_of = started(world, sightings)
    frame = tracked_in(tracker.map, point_of, sightings[3], 0)
    inliers = optimized(tracker, frame)
    assert inliers > 100 and variance(frame) < 0.01**2
    assert tracker.rules.loss.fault(tracker, frame, tracker.last, inliers) == ""
    tracker.map.noise.variance = 4e4  # keypoints might be anywhere
    assert optimized(tracker, frame) > 50
    assert tracker.rules.loss.fault(tracker, frame, tracker.last, inliers) == "uncertain_pose"


def test_a_keyframe_is_made_when_information_falls_and_not_before(world, sightings):
    tracker, point_of = started(world, sightings)
    frame = sightings[1].again()
    tracker.track(frame)
    later = tracked_in(tracker.map, point_of, sightings[5], 0)
    inliers = optimized(tracker, later)
    assert not tracker.wants_keyframe(later, inliers)
    rows = np.flatnonzero(later.point >= 0)
    later.point[rows[later.features.xy[rows, 0] < 400]] = -1
    assert tracker.wants_keyframe(later, optimized(tracker, later))
    tracker.keyframe_requested(later)
    assert tracker.sharpest == np.inf


def test_the_covariance_of_a_point_is_that_of_its_rays_and_turns_and_grows_with_the_map(world, sightings):
    built, _ = world.map_of(sightings[::5], np.random.default_rng(5))
    a, view = built.arrays, built.view
    p = int(built.points()[7])
    information = np.eye(3) / np.linalg.norm(a.pt_xyz[p] - np.linalg.inv(built.T_cam_map(0))[:3, 3]) ** 2
    e = int(a.pt_head[p])
    while e >= 0:
        T = built.T_cam_map(int(a.kp_keyframe[e]))
        x, y, z = T[:3, :3] @ a.pt_xyz[p] + T[:3, 3]
        J = np.array([[view.fx, 0, -view.fx * x / z], [0, view.fy, -view.fy * y / z]]) / z @ T[:3, :3]
        information += view.inv_sigma2[a.kp_octave[e]] * J.T @ J
        e = int(a.kp_next[e])
    row, column = [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]
    assert a.pt_covariance[p] == pytest.approx(np.linalg.inv(information)[row, column], rel=0.02)
    before = a.pt_covariance[p].copy()
    R = rigid(rotvec_deg=(20, 30, 40))[:3, :3]
    built.transform(2.0, R, np.zeros(3))
    full = np.empty((3, 3))
    full[row, column] = full[column, row] = before
    assert a.pt_covariance[p] == pytest.approx((4 * R @ full @ R.T)[row, column])


def test_a_smeared_frame_keeps_the_matches_that_sharp_windows_would_cut_off(world, sightings):
    """The points that are matched first tell its noise; by that the others are sought."""
    tracker, _ = started(world, sightings)
    for sighting in sightings[1:11]:
        assert tracker.track(sighting.again()).success
    smeared = world.see(11, walk(11), np.random.default_rng(6), noise_px=2.1, bits=8)
    frame = smeared.again()
    expected = tracker.track(sightings[11].again()).inliers
    tracker, _ = started(world, sightings, at=10)
    tracker.map.noise.variance, tracker.map.noise.frames = 0.49, 20
    assert tracker.track(frame).inliers > 0.85 * expected
    assert np.sqrt(frame.noise2) == pytest.approx(2.1, abs=0.3)


def test_where_the_last_frame_had_few_points_those_around_find_the_next(world, sightings):
    tracker, _ = started(world, sightings)
    last = tracker.last
    kept = np.flatnonzero(last.point >= 0)[:8]
    few = np.full_like(last.point, -1)
    few[kept] = last.point[kept]
    last.point[:] = few
    assert tracker.track(sightings[1].again()).inliers > 100


def test_a_view_of_another_place_disagrees_with_any_pose_behind_a_gap(world, sightings):
    tracker, point_of = started(world, sightings)
    here = tracked_in(tracker.map, point_of, sightings[3], 0)
    optimized(tracker, here)
    other = PointWorld(seed=7).see(3, walk(3), np.random.default_rng(8), noise_px=0.7, bits=8)
    for sighting, fault in ((sightings[3], ""), (other, "view_disagrees")):
        frame = sighting.again()
        frame.T_cam_map, frame.covariance = here.T_cam_map, here.covariance
        assert tracker.rules.loss.fault_of_view(tracker, frame, tracker.last) == ""
        tracker.passed_over = 3
        assert tracker.rules.loss.fault_of_view(tracker, frame, tracker.last) == fault
        tracker.passed_over = 0
