"""Backward propagation over the buffer: to the old map, over unusable frames, and its failures."""

from dataclasses import replace

import numpy as np
import pytest
from slam_scenes import CAMERA, FPS, PointWorld, make_frame, pose_error, rigid, tracked_in, walk

from dslab.slam.core.frame import Frame
from dslab.slam.dual.fusion.fuse import FusionConfig
from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryTask, ReusedTime
from dslab.slam.dual.recovery.orb import OrbRecovery
from dslab.slam.dual.recovery.propagation import Overlap
from dslab.slam.dual.recovery_jobs import placed_keyframes
from dslab.slam.features.remembered import Remembered
from dslab.slam.map.invariants import check_map
from dslab.slam.optimization.sim3 import sim3_decompose

OLD = range(0, 35, 5)  # frames that are the old map's keyframes
BLIND = range(31, 38)  # frames that show nothing
FIRST = 45  # the new map's first frame
SCALE = 0.5
MOVED = rigid((1.0, -2.0, 0.5), (10, -20, 15))


@pytest.fixture(scope="module")
def world():
    return PointWorld(seed=31)


@pytest.fixture(scope="module")
def sightings(world):
    rng = np.random.default_rng(32)
    return [world.see(i, walk(i), rng, noise_px=0.4, bits=8) for i in range(66)]


@pytest.fixture(scope="module")
def saved(world, sightings):
    """The map that broke."""
    return world.map_of([sightings[i] for i in OLD], np.random.default_rng(33), noise=0.005)[0]


@pytest.fixture(scope="module")
def start_map(world, sightings):
    """The new map after the breakage, of another frame and scale, and its points."""
    seen = [sightings[i] for i in range(FIRST, 66, 5)]
    built, point_of = world.map_of(seen, np.random.default_rng(34), noise=0.005, map_id=1)
    built.transform(SCALE, MOVED[:3, :3], MOVED[:3, 3])
    return built, point_of


def in_new_map(T_cam_world):
    """A pose of the world in the new map's frame and scale."""
    T = T_cam_world @ np.linalg.inv(MOVED)
    T[:3, 3] = SCALE * T_cam_world[:3, 3] - T[:3, :3] @ MOVED[:3, 3]
    return T


def no_image(index):
    """Fail: no frame is held as an image."""
    raise KeyError(index)


def task(start_map, sightings, old_maps, backward, seed=0):
    built, point_of = start_map
    own = built.copy()
    first = tracked_in(own, point_of, sightings[FIRST], 0, own.T_cam_map(0))
    step = in_new_map(sightings[FIRST].T_cam_world) @ np.linalg.inv(
        in_new_map(sightings[FIRST + 1].T_cam_world)
    )
    rng = np.random.default_rng(seed)
    return RecoveryTask(own, first, tuple(backward), old_maps, step, rng, CAMERA, no_image)


def buffered(sightings, oldest=0, blind=BLIND):
    """Features of the frames before the new map's first, newest first; nothing but noise in ``blind``."""
    rng = np.random.default_rng(35)
    for i in range(FIRST - 1, oldest - 1, -1):
        yield make_frame(i, rng, n=20).features if i in blind else sightings[i].frame.features


def recover(task_, **config):
    return OrbRecovery(RecoveryConfig(**config)).run(task_)


@pytest.fixture(scope="module")
def success(start_map, sightings, saved):
    untouched = saved.copy()
    result = recover(task(start_map, sightings, [saved], buffered(sightings)))
    return result, untouched


def same(a, b):
    """Return True if two maps are the same, bit by bit."""
    arrays = zip(a.arrays, b.arrays, strict=True)
    return (a.n_keyframes, a.n_points) == (b.n_keyframes, b.n_points) and all(
        x.tobytes() == y.tobytes() for x, y in arrays
    )


def disturbed(features, view):
    """Every other keypoint displaced within the search windows: their points match and are outliers."""
    off = 3.2 * view.scale[features.octave] * np.sin(np.arange(len(features)) * np.pi / 2)
    return replace(features, xy=features.xy + np.stack([0 * off, off], axis=1))


# -- success -------------------------------------------------------------------------------------------------


def test_the_old_map_is_reached_across_blank_frames(success):
    result, _ = success
    assert result.success and (result.stage, result.reason) == ("", "")
    assert result.frames_passed_over == len(BLIND)
    assert result.alignment.old_map_id == 0
    assert result.alignment.scale == pytest.approx(1 / SCALE, rel=0.02)
    assert result.inliers == result.alignment.inliers >= FusionConfig().min_matches
    check_map(result.map)


def test_two_alignments_are_needed(success):
    """The accepted alignment is the second one: that of the youngest keyframe has been confirmed by it."""
    result, _ = success
    assert OLD[result.alignment.old_keyframe] < OLD[-1]
    covered = FIRST - OLD[result.alignment.old_keyframe]
    assert abs(result.frames_covered - covered) <= FPS * FusionConfig().max_time_gap_s


def test_the_similarity_places_the_new_cameras_near_the_truth(success, sightings):
    result, _ = success
    assert result.alignment is not None
    s, R, t = sim3_decompose(result.alignment.S_old_new)
    for k, i in enumerate(range(FIRST, 66, 5)):
        T_map_cam = np.linalg.inv(result.map.T_cam_map(k))
        centre = s * R @ T_map_cam[:3, 3] + t
        assert np.linalg.norm(centre - np.linalg.inv(sightings[i].T_cam_world)[:3, 3]) < 0.15


def test_the_first_keyframes_are_reported_in_the_old_map(success, start_map, sightings):
    """Culled or not, and only those."""
    result, _ = success
    extended = result.map.copy()
    extended.cull_keyframe(2)
    placed = placed_keyframes(extended, start_map[0].n_keyframes, result.alignment)
    assert [k.frame for k in placed] == list(range(FIRST, 66, 5))
    for keyframe in placed:
        assert keyframe.stamp_s == pytest.approx(keyframe.frame / FPS)
        T_old_cam = np.array(keyframe.T_old_cam)
        assert np.linalg.det(T_old_cam[:3, :3]) == pytest.approx(1.0)
        T_cam_old = np.linalg.inv(T_old_cam)
        distance, angle = pose_error(T_cam_old, sightings[keyframe.frame].T_cam_world)
        assert distance < 0.15 and angle < 1.0


def test_the_new_map_grows_backward(success, start_map):
    result, _ = success
    added = [result.map.frame_index(k) for k in range(start_map[0].n_keyframes, result.map.n_keyframes)]
    assert len(added) >= 2
    assert added == sorted(added, reverse=True)
    assert min(added) < BLIND[0] and max(added) < FIRST
    assert len(result.map.points()) > len(start_map[0].points())


def test_every_frame_tracked_backward_has_its_own_pose(success, sightings):
    """Also the last one before the blank frames, from which the motion model predicts."""
    result, _ = success
    frames = [f.features.index for f in result.frames]
    expected = [i for i in range(FIRST - 1, frames[-1] - 1, -1) if i not in BLIND]
    assert frames == expected
    for frame in result.frames:
        T = frame.T_cam_reference @ result.map.T_cam_map(frame.reference_keyframe)
        distance, angle = pose_error(T, in_new_map(sightings[frame.features.index].T_cam_world))
        assert distance < 0.05 and angle < 0.5


def test_the_old_map_and_the_features_are_not_changed(success, saved):
    assert same(saved, success[1])


def test_the_same_seed_gives_the_same_recovery(success, start_map, sightings, saved):
    again = recover(task(start_map, sightings, [saved], buffered(sightings)))
    assert again.alignment is not None
    np.testing.assert_array_equal(again.alignment.S_old_new, success[0].alignment.S_old_new)
    assert same(again.map, success[0].map)


def test_of_several_old_maps_the_matching_one_is_aligned(world, start_map, sightings, saved):
    """A younger map of another scene stands at the same frames; it is tried, and the older one met."""
    rng = np.random.default_rng(36)
    elsewhere = PointWorld(seed=77)
    other, _ = elsewhere.map_of([elsewhere.see(i, walk(i), rng) for i in (25, 30)], rng, map_id=5)
    result = recover(task(start_map, sightings, [other, saved], buffered(sightings)))
    assert result.alignment is not None and result.alignment.old_map_id == 0


def test_frames_with_many_outliers_are_placed_by_what_is_right(start_map, sightings, saved):
    poor = range(38, 42)
    backward = [
        disturbed(features, start_map[0].view) if features.index in poor else features
        for features in buffered(sightings)
    ]
    found = OrbRecovery().run(task(start_map, sightings, [saved], backward))
    assert found.success
    poses = {f.features.index: f.T_cam_map for f in found.frames}
    for i in poor:
        distance, angle = pose_error(poses[i], in_new_map(sightings[i].T_cam_world))
        assert distance < 0.02 and angle < 0.2


def test_many_blank_frames_are_bridged(start_map, sightings, saved):
    """Half a second: nothing is near its last position afterwards."""
    job = task(start_map, sightings, [saved], buffered(sightings, blind=range(22, 38)))
    result = recover(job)
    assert result.success and result.frames_passed_over == 16


def test_the_limit_is_on_each_run_of_blank_frames(start_map, sightings, saved):
    blind = {*range(31, 38), *range(40, 44)}
    job = task(start_map, sightings, [saved], buffered(sightings, blind=blind))
    result = recover(job, max_unusable_s=9.5 / FPS)
    assert result.success and result.frames_passed_over == len(blind)


# -- failure -------------------------------------------------------------------------------------------------


def failed(result, old, untouched):
    assert not result.success and result.alignment is None
    assert same(old, untouched)
    check_map(result.map)
    return result.stage, result.reason


def test_too_many_blank_frames_end_the_propagation(start_map, sightings, saved):
    untouched = saved.copy()
    job = task(start_map, sightings, [saved], buffered(sightings))
    result = recover(job, max_unusable_s=(len(BLIND) - 2) / FPS)
    assert failed(result, saved, untouched) == ("propagation", "too_few_matches_with_last_frame")
    assert result.frames_covered == FIRST - BLIND[0] - 1
    assert BLIND[0] < min(f.features.index for f in result.frames)


def test_blank_frames_only_end_the_propagation(start_map, sightings, saved):
    untouched = saved.copy()
    result = recover(
        task(start_map, sightings, [saved], buffered(sightings, blind=range(FIRST))), max_unusable_s=0.5
    )
    assert failed(result, saved, untouched) == ("propagation", "too_few_matches_with_last_frame")
    assert result.frames == []


def test_a_buffer_that_ends_before_the_old_map_is_reported(start_map, sightings, saved):
    untouched = saved.copy()
    result = recover(task(start_map, sightings, [saved], buffered(sightings, oldest=38)))
    assert failed(result, saved, untouched) == ("overlap", "old_map_not_reached")
    assert result.frames_covered == FIRST - 38 and len(result.frames) == FIRST - 38


def test_an_empty_buffer_is_reported(start_map, sightings, saved):
    result = recover(task(start_map, sightings, [saved], []))
    assert (result.stage, result.reason, result.frames_covered) == ("overlap", "old_map_not_reached", 0)


def test_an_old_map_without_common_points_is_reported(world, start_map, sightings):
    """Its keyframes have the right frame indices, but show another scene."""
    rng = np.random.default_rng(37)
    elsewhere = PointWorld(seed=78)
    other, _ = elsewhere.map_of([elsewhere.see(i, walk(i), rng) for i in OLD], rng)
    untouched = other.copy()
    result = recover(task(start_map, sightings, [other], buffered(sightings)))
    assert failed(result, other, untouched) == ("overlap", "too_few_common_points")


def test_a_corrupted_old_map_is_not_aligned(start_map, sightings, saved):
    broken = saved.copy()
    points = broken.points()
    broken.arrays.pt_xyz[points] = np.random.default_rng(38).permutation(broken.arrays.pt_xyz[points])
    untouched = broken.copy()
    result = recover(task(start_map, sightings, [broken], buffered(sightings)))
    assert failed(result, broken, untouched) == ("sim3", "too_few_inliers")


def test_a_single_alignment_is_not_confirmed(start_map, sightings, saved):
    untouched = saved.copy()
    result = recover(task(start_map, sightings, [saved], buffered(sightings, oldest=29)))
    assert failed(result, saved, untouched) == ("sim3", "alignment_not_confirmed")
    lax = RecoveryConfig(fusion=replace(FusionConfig(), confirmations=1))
    assert OrbRecovery(lax).run(task(start_map, sightings, [saved], buffered(sightings, oldest=29))).success


def test_contradicting_alignments_are_refused(world, start_map, sightings):
    """An old map whose two parts have different scales, as after a drift: each fits, both do not."""
    rng = np.random.default_rng(39)
    torn, _ = world.map_of([sightings[i] for i in (12, 24)], rng, noise=0.005)
    late, _ = world.map_of([sightings[i] for i in (25, 30)], rng, noise=0.005)
    late.transform(1.3, np.eye(3), np.zeros(3))
    keyframes, _ = torn.absorb(late)
    torn.set_parent(keyframes, 1)
    untouched = torn.copy()
    config = RecoveryConfig(fusion=replace(FusionConfig(), max_time_gap_s=0.0))
    result = OrbRecovery(config).run(
        task(start_map, sightings, [torn], (f for f in buffered(sightings, oldest=20) if f.index != 25))
    )
    assert failed(result, torn, untouched) == ("sim3", "alignments_do_not_agree")


@pytest.mark.parametrize(("frames_on", "apart_s", "compared"), [(3, 0.1, 1), (3, 0.3, 0), (10, 0.16, 1)])
def test_keyframes_are_compared_by_time_whatever_the_frame_rate(
    start_map, sightings, saved, frames_on, apart_s, compared
):
    stamp_s = saved.features(len(OLD) - 1).stamp_s + apart_s
    features = replace(sightings[OLD[-1] + frames_on].frame.features, stamp_s=stamp_s)
    overlap = Overlap(task(start_map, sightings, [saved], []), FusionConfig())
    overlap.attempt(Frame(features), 0)
    assert overlap.tried == compared


# -- what is found in images ---------------------------------------------------------------------------------


def test_a_run_reuses_what_another_has_found_in_an_image_and_tells_the_time(start_map, sightings, saved):
    images, found = [np.full((8, 8), v, np.uint8) for v in (1, 2)], []

    def find(image):
        found.append(int(image[0, 0]))
        return [len(found)]

    plain = task(start_map, sightings, [saved], ())
    plain = replace(plain, image_of=images.__getitem__)
    assert [plain.found_in(0, find, "a"), plain.found_in(0, find, "a")] == [[1], [2]]
    remembered = Remembered(8)
    one, two = (replace(plain, remembered=remembered, reused=ReusedTime()) for _ in range(2))
    first = one.found_in(0, find, "a")
    assert two.found_in(0, find, "a") is first and found == [1, 1, 1]
    assert one.reused.cpu_ms == 0 < two.reused.cpu_ms
    assert two.found_in(0, find, "b") is not first and two.found_in(1, find, "a") is not first
    assert found == [1, 1, 1, 1, 2]
