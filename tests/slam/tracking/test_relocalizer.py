"""Relocalizer: a single frame is placed in a world of known points, and in no other."""

import numpy as np
import pytest
from slam_scenes import (
    VIEW,
    PointWorld,
    pose_error,
    rigid,
    walk,
)

from dslab.slam.core.geometry import camera_centre
from dslab.slam.map.map import Map
from dslab.slam.places.recognition import KeyframeDatabase
from dslab.slam.places.training import train_vocabulary
from dslab.slam.tracking.config import TrackingConfig
from dslab.slam.tracking.reach import Reach
from dslab.slam.tracking.relocalization import RelocalizationConfig, Relocalizer
from dslab.slam.tracking.rules.registry import rules_of

STEP_M = 0.05
RULES = rules_of(TrackingConfig())


def rng():
    return np.random.default_rng(0)


@pytest.fixture(scope="module")
def known():
    world, r = PointWorld(points=5000), np.random.default_rng(1)
    seen = [world.see(i, walk(i), r, noise_px=0.5, bits=6) for i in range(0, 80, 8)]
    built, point_of = world.map_of(seen, r)
    vocabulary = train_vocabulary([s.frame.features.descriptors for s in seen], 8, 3, 0)
    return world, built, point_of, vocabulary


def relocalizer(known, **config):
    return Relocalizer(known[1], KeyframeDatabase(known[1], known[3]), RelocalizationConfig(**config), RULES)


def look(known, T_cam_world, share=0.7):
    return known[0].see(500, T_cam_world, np.random.default_rng(7), noise_px=0.5, bits=6, share=share)


@pytest.mark.parametrize(("at", "turn_deg"), [(4, 8.0), (37, 0.0), (61, 8.0)])
def test_a_frame_beside_the_path_gets_its_pose(known, at, turn_deg):
    T = rigid((0.1, -0.1, 0.15), (0, turn_deg, 0)) @ walk(at)
    sighting = look(known, T)
    frame = sighting.again()
    outcome = relocalizer(known).relocalize(frame, rng())
    assert outcome.success and outcome.reason == ""
    assert outcome.inliers == (frame.point >= 0).sum() >= 50 and outcome.matches >= outcome.inliers
    distance, angle_deg = pose_error(frame.T_cam_map, T)
    assert distance < 0.03 and angle_deg < 0.3
    matched = np.flatnonzero(frame.point >= 0)
    right = frame.point[matched] == known[2][sighting.ids[matched]]
    assert right.mean() > 0.98
    m = known[1]
    T_back = frame.T_cam_reference @ m.T_cam_map(frame.reference_keyframe)
    assert pose_error(T_back, frame.T_cam_map) == pytest.approx((0, 0), abs=1e-6)
    votes = [np.isin(frame.point[matched], m.observed_points(k)).sum() for k in range(m.n_keyframes)]
    assert votes[frame.reference_keyframe] == max(votes)


def test_coplanar_points_give_the_pose():
    """A wall in front of the camera: the pose of a plane has two solutions."""
    world, r = PointWorld(seed=3), np.random.default_rng(1)
    world.xyz[:, 2] = 5.0
    seen = [world.see(i, walk(i), r, noise_px=0.5, bits=6) for i in range(0, 60, 8)]
    built, _ = world.map_of(seen, r)
    vocabulary = train_vocabulary([s.frame.features.descriptors for s in seen], 8, 3, 0)
    frame = world.see(500, walk(30), r, noise_px=0.5, bits=6).again()
    found = Relocalizer(built, KeyframeDatabase(built, vocabulary), RelocalizationConfig(), RULES)
    assert found.relocalize(frame, rng()).success
    distance, angle_deg = pose_error(frame.T_cam_map, walk(30))
    assert distance < 0.05 and angle_deg < 0.6


def test_frames_of_another_world_are_refused(known):
    other = PointWorld(seed=99, points=5000)
    for i in range(0, 80, 20):
        frame = other.see(i, walk(i), np.random.default_rng(i)).again()
        outcome = relocalizer(known).relocalize(frame, rng())
        assert not outcome.success and outcome.reason
        assert (frame.point == -1).all() and np.isnan(frame.T_cam_map).all()
        assert frame.reference_keyframe == -1


def test_the_guided_search_adds_inliers(known):
    frame = look(known, walk(37)).again()
    outcome = relocalizer(known, min_inliers=0).relocalize(frame, rng())
    unguided = outcome.inliers
    assert unguided >= 10
    outcome = relocalizer(known, min_inliers=unguided + 1).relocalize(frame, rng())
    assert outcome.success and outcome.inliers > 1.3 * unguided


@pytest.mark.parametrize(
    ("config", "reason"),
    [
        ({"candidates": 0}, "no_candidates"),
        ({"min_matches": 10_000}, "too_few_matches"),
        ({"min_pose_inliers": 10_000}, "no_pose"),
        ({"min_inliers": 10_000}, "too_few_inliers"),
    ],
)
def test_the_reason_is_that_of_the_farthest_attempt(known, config, reason):
    frame = look(known, walk(37)).again()
    outcome = relocalizer(known, **config).relocalize(frame, rng())
    assert not outcome.success and outcome.reason == reason
    assert (outcome.inliers > 0) is (reason == "too_few_inliers")


def test_noise_that_hides_the_words_of_an_image_does_not_hide_its_matches(known):
    """With 30 bits of noise half of the features have another word than in the map."""
    frame = known[0].see(500, walk(37), np.random.default_rng(7), noise_px=0.5, bits=30).again()
    outcome = relocalizer(known).relocalize(frame, rng(), similar=[4])
    assert outcome.success and outcome.matches > 100
    assert pose_error(frame.T_cam_map, walk(37))[0] < 0.03


def test_a_keyframe_is_tried_however_unlike_it_is(known):
    frame = look(known, walk(37)).again()
    assert relocalizer(known).relocalize(frame, rng(), similar=[]).reason == "no_candidates"
    outcome = relocalizer(known).relocalize(frame, rng(), similar=[], also=[4])
    assert outcome.success and outcome.keyframe == 4


def test_an_empty_frame_and_an_empty_map_have_no_candidates(known):
    sighting = known[0].see(500, rigid((0, 0, -1000)), rng(), clutter=0)
    assert len(sighting.frame.features) == 0
    assert relocalizer(known).relocalize(sighting.again(), rng()).reason == "no_candidates"
    empty = Map(0, VIEW)
    nowhere = Relocalizer(empty, KeyframeDatabase(empty, known[3]), RelocalizationConfig(), RULES)
    assert nowhere.relocalize(look(known, walk(37)).again(), rng()).reason == "no_candidates"


def test_of_two_places_that_look_alike_neither_is_taken_unless_the_camera_can_only_have_come_to_one(known):
    """The same things again, 40 m away: both fit as well."""
    world, r = known[0], np.random.default_rng(1)
    again = [rigid((-40, 0, 0))] * 10
    seen = [world.see(i, walk(i), r, noise_px=0.5, bits=6) for i in range(0, 80, 8)]
    twin = PointWorld(points=5000)
    twin.xyz = twin.xyz + np.array([40.0, 0.0, 0.0])
    seen += [
        twin.see(100 + i, walk(i) @ T, r, noise_px=0.5, bits=6)
        for i, T in zip(range(0, 80, 8), again, strict=True)
    ]
    both = PointWorld(points=5000)
    both.xyz = np.concatenate([world.xyz, twin.xyz])
    for sighting in seen[10:]:
        sighting.ids[sighting.ids >= 0] += 5000
    built, _ = both.map_of(seen, r)
    frame = look(known, walk(37)).again()
    database = KeyframeDatabase(built, known[3])
    relocalizer = Relocalizer(built, database, RelocalizationConfig(), RULES)
    outcome = relocalizer.relocalize(frame, rng())
    assert (outcome.success, outcome.reason) == (False, "ambiguous")
    bold = Relocalizer(built, database, RelocalizationConfig(min_margin=1.0), RULES)
    assert bold.relocalize(frame, rng()).success
    for at in (0.0, 40.0):
        near = Reach(np.array([at, 0.0, 0.0]) + camera_centre(walk(36)), frame.features.stamp_s, 1.0)
        found = relocalizer.relocalize(frame, rng(), near)
        assert found.success and abs(camera_centre(frame.T_cam_map)[0] - near.centre[0]) < 1
