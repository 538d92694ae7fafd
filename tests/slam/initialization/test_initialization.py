"""Initialization: the first map equals the scene up to scale, and unsuitable frames are refused."""

import numpy as np
import pytest
from slam_scenes import CAMERA, VIEW, PointWorld, make_frame, pose_error, rigid, world_ids

from dslab.slam.core.frame import Frame
from dslab.slam.initialization import initializer as initialization
from dslab.slam.initialization.initializer import InitializationConfig, Initializer
from dslab.slam.initialization.two_view import TwoViewConfig
from dslab.slam.map.invariants import check_map
from dslab.slam.mapping.local_mapping import LocalMappingConfig
from dslab.slam.optimization.sim3 import horn_sim3

MATCHERS = ("windowed", "gms")
WORLD = PointWorld(seed=3, points=6000, reach=(-6.0, 6.0))
STEP = np.array([0.12, 0.02, -0.03])


def look(i, rng, step=STEP, noise_px=0.4):
    T_world_cam = rigid(i * step, (0.2 * i, -0.1 * i, 0.3 * i))
    return WORLD.see(i, np.linalg.inv(T_world_cam), rng, noise_px=noise_px, bits=10)


def initializer(**settings):
    return Initializer(CAMERA, VIEW, InitializationConfig(**settings))


def offer(seeker, frame, seed=0, map_id=4):
    return seeker.offer(frame, map_id, np.random.default_rng(seed), LocalMappingConfig())


def first_map(seed=0, **settings):
    """The map, its two sightings, and the reasons of the frames refused before."""
    rng = np.random.default_rng(seed)
    seeker = initializer(**settings)
    sightings, reasons = [], []
    for i in range(20):
        sightings.append(look(i, rng))
        initial, reason, _ = offer(seeker, sightings[-1].frame)
        if initial is not None:
            return initial, (sightings[0], sightings[-1]), reasons, seeker
        reasons.append(reason)
    raise AssertionError(f"no map: {reasons}")


@pytest.mark.parametrize("matcher", MATCHERS)
def test_a_few_frames_of_motion_give_a_map_of_the_scene_up_to_scale(matcher):
    for seed in range(3):
        initial, (one, two), reasons, _ = first_map(seed, matcher=matcher)
        assert reasons[0] == "reference_frame" and len(reasons) <= 8
        built = initial.map
        check_map(built)
        assert len(built.keyframes()) == 2
        assert initial.points == len(built.points()) >= 100
        assert (initial.first.features.index, initial.second.features.index) == (0, len(reasons))
        ids, pure = world_ids(built, [one, two])
        found = built.points()[pure[built.points()]]
        assert len(found) > 0.97 * initial.points
        T_1_world = one.T_cam_world
        truth = WORLD.xyz[ids[found]] @ T_1_world[:3, :3].T + T_1_world[:3, 3]
        s, R, t = horn_sim3(truth, built.arrays.pt_xyz[found])
        error = np.linalg.norm(s * built.arrays.pt_xyz[found] @ R.T + t - truth, axis=1)
        assert np.median(error / truth[:, 2]) < 0.08
        metric = built.T_cam_map(1).copy()
        metric[:3, 3] *= s
        distance, turn_deg = pose_error(metric, two.T_cam_world @ np.linalg.inv(T_1_world))
        assert distance < 0.15 * np.linalg.norm(STEP) * len(reasons) and turn_deg < 0.4


def test_the_map_starts_at_the_origin_with_unit_median_depth():
    initial, *_ = first_map()
    np.testing.assert_array_equal(initial.map.T_cam_map(0), np.eye(4))
    depth = initial.map.arrays.pt_xyz[initial.map.points(), 2]
    assert np.median(depth) == pytest.approx(1.0, rel=0.02)


def test_both_frames_are_returned_as_tracked():
    initial, *_, seeker = first_map()
    for keyframe, frame in enumerate((initial.first, initial.second)):
        np.testing.assert_array_equal(frame.point, initial.map.observed_points(keyframe))
        assert (frame.point >= 0).sum() == initial.points
        np.testing.assert_array_equal(frame.T_cam_map, initial.map.T_cam_map(keyframe))
        np.testing.assert_array_equal(frame.T_cam_reference, np.eye(4))
        assert frame.reference_keyframe == keyframe
    assert seeker.reference is None


@pytest.mark.parametrize("matcher", MATCHERS)
def test_the_same_frames_and_seed_give_the_same_bits(matcher):
    one, *_ = first_map(matcher=matcher)
    two, *_ = first_map(matcher=matcher)
    np.testing.assert_array_equal(one.map.arrays.pt_xyz, two.map.arrays.pt_xyz)
    np.testing.assert_array_equal(one.map.T_cam_map(1), two.map.T_cam_map(1))


@pytest.mark.parametrize("matcher", MATCHERS)
def test_a_static_or_rotating_camera_gives_no_map(matcher):
    for turn_deg in (0.0, 0.3):
        rng = np.random.default_rng(1)
        seeker = initializer(matcher=matcher)
        for i in range(8):
            T_cam_world = rigid(rotvec_deg=(0, turn_deg * i, 0))
            initial, reason, _ = offer(seeker, WORLD.see(i, T_cam_world, rng, noise_px=0.4).frame)
            assert initial is None
            assert reason == ("reference_frame" if i == 0 else "low_parallax")
        assert seeker.reference is not None and seeker.reference.features.index == 0


def test_a_frame_with_few_keypoints_clears_the_reference():
    rng = np.random.default_rng(2)
    seeker = initializer()
    few = make_frame(0, rng, n=99)
    assert offer(seeker, few)[1:] == ("too_few_keypoints", 0)
    assert seeker.reference is None
    offer(seeker, look(0, rng).frame)
    assert seeker.reference is not None
    assert offer(seeker, few)[1] == "too_few_keypoints"
    assert seeker.reference is None


def test_a_frame_with_few_matches_becomes_the_reference():
    rng = np.random.default_rng(3)
    seeker = initializer()
    offer(seeker, look(0, rng).frame)
    other = Frame(make_frame(7, rng, n=800).features)
    initial, reason, matches = offer(seeker, other)
    assert initial is None and reason == "too_few_matches" and matches < 100
    assert seeker.reference is other
    seeker.reset()
    assert seeker.reference is None


def test_matches_are_tracked_beyond_the_search_window():
    settings = {"radius_px": 25.0, "two_view": TwoViewConfig(min_parallax_deg=60.0)}
    rng = np.random.default_rng(8)
    frames = [look(i, rng).frame for i in range(7)]
    in_steps, at_once = initializer(**settings), initializer(**settings)
    reasons = [offer(in_steps, frame)[1] for frame in frames]
    assert reasons[1:] == ["low_parallax"] * 6
    offer(at_once, frames[0])
    assert offer(at_once, frames[-1])[1] == "too_few_matches"


def test_gms_initializes_with_motions_beyond_the_search_window():
    """With a rotation of 120 px per frame the windowed search restarts at every frame."""
    rng = np.random.default_rng(9)

    def leap(i):
        T_world_cam = rigid(i * np.array([0.5, 0.05, -0.1]), (0, 14.0 * i, 0))
        return WORLD.see(i, np.linalg.inv(T_world_cam), rng, noise_px=0.4, bits=10)

    sightings = [leap(i) for i in range(3)]
    outcomes = {}
    for matcher in MATCHERS:
        seeker = initializer(matcher=matcher)
        outcomes[matcher] = [offer(seeker, sighting.frame) for sighting in sightings[:2]]
    assert outcomes["windowed"][1][1] == "too_few_matches"
    initial = outcomes["gms"][1][0]
    assert initial is not None
    estimate = initial.map.T_cam_map(1)
    truth = sightings[1].T_cam_world @ np.linalg.inv(sightings[0].T_cam_world)
    metric = estimate.copy()
    metric[:3, 3] *= np.linalg.norm(truth[:3, 3]) / np.linalg.norm(estimate[:3, 3])
    distance, turn_deg = pose_error(metric, truth)
    assert distance < 0.1 * np.linalg.norm(truth[:3, 3]) and turn_deg < 0.4


def test_gms_initializes_no_later():
    for seed in range(3):
        taken = {matcher: len(first_map(seed, matcher=matcher)[2]) for matcher in MATCHERS}
        assert taken["gms"] <= taken["windowed"]


def test_an_unknown_matcher_is_refused():
    with pytest.raises(ValueError, match="'windowed', 'gms' or 'gms_alone'"):
        InitializationConfig(matcher="psychic")  # pyright: ignore[reportArgumentType]


def test_the_reason_of_the_two_view_geometry_is_reported():
    rng = np.random.default_rng(4)
    seeker = initializer(two_view=TwoViewConfig(min_parallax_deg=60.0))
    offer(seeker, look(0, rng).frame)
    initial, reason, matches = offer(seeker, look(4, rng).frame)
    assert (initial, reason) == (None, "low_parallax") and matches >= 100


def test_too_few_points_after_adjustment_restart_from_the_frame():
    rng = np.random.default_rng(5)
    seeker = initializer(min_points=100_000)
    reasons = []
    for i in range(20):
        frame = look(i, rng).frame
        initial, reason, _ = offer(seeker, frame)
        assert initial is None
        reasons.append(reason)
        if reason == "few_points_after_adjustment":
            assert seeker.reference is frame
            break
    assert reasons[-1] == "few_points_after_adjustment"


def test_coarse_keypoints_are_weighted_by_their_noise(monkeypatch):
    """The geometry gets the scale of each match's pyramid level."""
    seen = []

    def spy(pixels_1, pixels_2, K, rng, config, scale):
        seen.append((pixels_1, scale))
        return two_view(pixels_1, pixels_2, K, rng, config, scale)

    two_view = initialization.two_view_reconstruction
    monkeypatch.setattr(initialization, "two_view_reconstruction", spy)
    rng = np.random.default_rng(6)
    seeker = initializer()
    one = look(0, rng).frame
    offer(seeker, one)
    offer(seeker, look(4, rng).frame)
    pixels, scale = seen[0]
    octave = {
        tuple(p): o for p, o in zip(one.features.xy.tolist(), one.features.octave.tolist(), strict=True)
    }
    expected = [VIEW.scale[octave[tuple(p)]] for p in pixels.tolist()]
    np.testing.assert_array_equal(scale, expected)
    assert len(set(expected)) > 1
