"""Local mapping of a keyframe: new points, fusion of duplicates, bundle adjustment, culling."""

from dataclasses import replace

import numpy as np
import pytest
from slam_scenes import PointWorld, pose_error, random_map, rigid, rms, tracked_in, walk, world_ids

from dslab.slam.core.frame import Frame
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.invariants import check_map
from dslab.slam.mapping._local_problem import local_problem
from dslab.slam.mapping.local_mapping import LocalMapper, LocalMappingConfig
from dslab.slam.optimization.sim3 import horn_sim3

NOISE_PX = 0.5


@pytest.fixture(scope="module")
def world():
    return PointWorld(seed=11, points=2500, reach=(-3.0, 8.0))


@pytest.fixture(scope="module")
def sightings(world):
    """Frames of the keyframes, about ten per second of a walk."""
    rng = np.random.default_rng(12)
    return [world.see(i, walk(i), rng, NOISE_PX, bits=8) for i in range(0, 60, 5)]


def start(world, sightings, noise=0.01, keep=0.4, keyframes=3, config=None):
    """A map of the first keyframes with some of the points, and its mapper."""
    built, point_of = world.map_of(sightings[:keyframes], np.random.default_rng(13), noise, keep)
    return LocalMapper(built, config or LocalMappingConfig()), point_of


def next_frame(mapper, point_of, sighting, shake=0.0):
    """The sighting, tracked in the map; its pose off by ``shake`` metres."""
    T = rigid((shake, -shake, shake), (0, 20 * shake, 0)) @ sighting.T_cam_world
    return tracked_in(mapper.map, point_of, sighting, int(mapper.map.keyframes()[-1]), T)


def distances(built, world, points, ids):
    """Errors of points up to scale, which one fixed camera leaves free."""
    s, R, t = horn_sim3(world.xyz[ids[points]], built.arrays.pt_xyz[points])
    assert abs(s - 1) < 0.05
    return np.linalg.norm(s * built.arrays.pt_xyz[points] @ R.T + t - world.xyz[ids[points]], axis=1)


def reprojection_px(built):
    """Error of every observation, in standard deviations of its keypoint."""
    a = built.arrays
    errors = []
    for k in built.keyframes():
        rows = np.flatnonzero(built.observed_points(int(k)) >= 0) + built.keypoints(int(k)).start
        T = built.T_cam_map(int(k))
        xyz = a.pt_xyz[a.kp_point[rows]] @ T[:3, :3].T + T[:3, 3]
        v = built.view
        xy = xyz[:, :2] / xyz[:, 2:] * (v.fx, v.fy) + (v.cx, v.cy)
        errors.append((xy - a.kp_xy[rows]) / v.scale[a.kp_octave[rows], None])
    return np.concatenate(errors).ravel()


# -- growth --------------------------------------------------------------------------------------------------


def test_new_points_are_near_the_truth_and_purely_observed(world, sightings):
    mapper, point_of = start(world, sightings)
    known = mapper.map.n_points
    keyframe = mapper.insert(next_frame(mapper, point_of, sightings[3]))
    check_map(mapper.map)
    assert keyframe == 3
    ids, pure = world_ids(mapper.map, sightings[:4])
    new = mapper.map.points()
    new = new[new >= known]
    assert len(new) > 300
    assert pure[new].mean() > 0.99
    off = distances(mapper.map, world, new[pure[new]], ids)
    # Half a pixel, times the scale of the level, at six metres over a baseline of 0.3 to 0.9 m.
    assert np.median(off) < 0.1
    assert (off < 0.6).mean() > 0.99
    assert (mapper.map.arrays.pt_first_keyframe[new] == keyframe).all()
    assert (mapper.map.arrays.pt_observations[new] >= 2).all()


def test_points_are_matched_in_further_neighbours(world, sightings):
    """Triangulation gives two observations, fusion the others."""
    mapper, point_of = start(world, sightings)
    known = mapper.map.n_points
    mapper.insert(next_frame(mapper, point_of, sightings[3]))
    new = mapper.map.points()
    seen = mapper.map.arrays.pt_observations[new[new >= known]]
    assert (seen >= 3).mean() > 0.5


@pytest.mark.parametrize("barrier", [{"min_baseline": 10.0}, {"max_depth_error": 1e-4}, {"neighbours": 0}])
def test_without_baseline_parallax_or_neighbours_nothing_is_created(world, sightings, barrier):
    mapper, point_of = start(world, sightings, config=LocalMappingConfig(**barrier))
    known = mapper.map.n_points
    mapper.insert(next_frame(mapper, point_of, sightings[3]))
    assert mapper.map.n_points == known
    check_map(mapper.map)


def test_a_walk_keeps_the_map_valid_and_accurate(world, sightings):
    """Every keyframe is tracked from the points of the last one, with noise; drift stays small."""
    mapper, point_of = start(world, sightings, noise=0.0, keep=0.6)
    good = pure = ids = np.empty(0)
    for k in range(3, len(sightings)):
        mapper.insert(next_frame(mapper, point_of, sightings[k], shake=0.01))
        check_map(mapper.map)
        ids, pure = world_ids(mapper.map, sightings[: k + 1])
        point_of = np.full(len(world.xyz), -1)
        good = np.flatnonzero(pure & (ids >= 0))
        point_of[ids[good]] = good
    assert pure[mapper.map.points()].mean() > 0.98
    assert np.median(distances(mapper.map, world, good, ids)) < 0.04
    for k in mapper.map.keyframes():
        distance, angle = pose_error(mapper.map.T_cam_map(int(k)), sightings[k].T_cam_world)
        assert distance < 0.06 and angle < 0.5
    assert len(good) > 1000


# -- fusion --------------------------------------------------------------------------------------------------


def test_duplicate_points_become_one(world, sightings):
    """The new keyframe has duplicates of points that its neighbours observe."""
    mapper, point_of = start(world, sightings, noise=0.002)
    m = mapper.map
    frame = next_frame(mapper, point_of, sightings[3])
    doubled = np.flatnonzero(frame.point >= 0)[:120]
    originals = frame.point[doubled].copy()
    frame.point[doubled] = -1
    fourth = sightings[4]
    keyframe = m.add_keyframe(next_frame(mapper, np.full_like(point_of, -1), fourth), 2)
    doubles = []
    for row, original in zip(doubled, originals, strict=True):
        elsewhere = np.flatnonzero(fourth.ids == sightings[3].ids[row])
        if len(elsewhere):
            p = m.create_point(m.arrays.pt_xyz[original] * 1.0005, m.keypoints(keyframe).start + elsewhere[0])
            frame.point[row] = p
            doubles.append((p, original))
    assert len(doubles) > 60
    mapper.insert(frame)
    check_map(m)
    resolved = [np.array(points, np.int32) for points in zip(*doubles, strict=True)]
    for points in resolved:
        kernels.resolve_points(m.arrays, points)
    assert np.equal(*resolved).mean() > 0.9


# -- adjustment ----------------------------------------------------------------------------------------------


def test_adjustment_lowers_the_reprojection_error_to_the_noise(world, sightings):
    mapper, _ = start(world, sightings, noise=0.05, keep=0.8, keyframes=5)
    m = mapper.map
    rng = np.random.default_rng(14)
    for k in range(2, 5):
        m.arrays.kf_T_cam_map[k] = rigid(rng.normal(0, 0.02, 3), rng.normal(0, 0.3, 3)) @ m.T_cam_map(k)
    before = reprojection_px(m)
    held = m.T_cam_map(0).copy()
    mapper.adjust(4)
    check_map(m)
    after = reprojection_px(m)
    assert rms(before) > 4
    # A little below the noise, since points and poses follow some of it.
    assert 0.6 * NOISE_PX < rms(after) < 1.02 * NOISE_PX
    assert len(after) > 0.9 * len(before)
    # With every keyframe free, the oldest fixes the gauge.
    np.testing.assert_array_equal(m.T_cam_map(0), held)
    for k in range(1, 5):
        assert pose_error(m.T_cam_map(k), sightings[k].T_cam_world)[1] < 0.1


def test_a_smeared_keyframe_pulls_less_once_it_has_told_its_noise(world):
    rng, noise_px = np.random.default_rng(101), [NOISE_PX] * 6
    noise_px[3] = 4.0
    views = [world.see(5 * i, walk(5 * i), rng, px, bits=8) for i, px in enumerate(noise_px)]
    off, kept = [], []
    for told in (False, True):
        mapper, _ = start(world, views, keep=0.9, keyframes=6)
        m = mapper.map
        m.noise.variance = NOISE_PX**2
        if told:
            m.take_features(3, replace(m.features(3), noise2=noise_px[3] ** 2))
        before = (m.observed_points(3) >= 0).sum()
        mapper.adjust(5)
        kept.append((m.observed_points(3) >= 0).sum() / before)
        at, true = (
            np.array([np.linalg.inv(T)[:3, 3] for T in poses])
            for poses in ([m.T_cam_map(k) for k in range(6)], [v.T_cam_world for v in views])
        )
        s, R, t = horn_sim3(true, at)
        off.append(np.linalg.norm(s * at @ R.T + t - true, axis=1).mean())
    assert off[1] < 0.6 * off[0]
    assert kept[0] < 0.3 and kept[1] > 0.98


def test_adjustment_moves_its_window_only(world, sightings):
    mapper, _ = start(world, sightings, keep=0.8, keyframes=8, config=LocalMappingConfig(window=3))
    m = mapper.map
    before = m.arrays.kf_T_cam_map[:8].copy()
    mapper.adjust(7)
    moved = {k for k in range(8) if not np.array_equal(before[k], m.arrays.kf_T_cam_map[k])}
    assert moved == {7, *m.neighbours(7, 2).tolist()}


def test_adjustment_drops_wrong_observations(world, sightings):
    mapper, _ = start(world, sightings, noise=0.0, keep=0.8, keyframes=5)
    m = mapper.map
    rows = np.flatnonzero(m.observed_points(2) >= 0)[::20] + m.keypoints(2).start
    wrong = m.arrays.kp_point[rows].copy()
    m.arrays.kp_xy[rows] += 40.0
    mapper.adjust(4)
    check_map(m)
    assert (m.arrays.kp_point[rows] < 0).mean() > 0.95
    seen_often = m.arrays.pt_observations[wrong] >= 3
    assert not m.arrays.pt_bad[wrong[seen_often]].any()


# -- culling -------------------------------------------------------------------------------------------------


def test_keyframes_that_add_nothing_are_culled(world):
    """Many keyframes at one place: few are kept, unless culling is disabled."""
    rng = np.random.default_rng(15)
    near = [world.see(i, walk(0.5 * i), rng, NOISE_PX, bits=8, share=0.9) for i in range(0, 20, 2)]
    left = {}
    for redundancy in (0.9, 1.0):
        mapper, point_of = start(world, near, keep=0.95, config=LocalMappingConfig(redundancy=redundancy))
        for sighting in near[3:]:
            mapper.insert(next_frame(mapper, point_of, sighting))
            check_map(mapper.map)
        left[redundancy] = mapper.map.keyframes()
    assert len(left[1.0]) == len(near)
    assert len(left[0.9]) <= 6
    assert left[0.9][0] == 0
    # The remaining ones still observe the map.
    assert len(mapper.map.points()) > 200


def test_young_points_that_are_not_found_again_are_dropped(world, sightings):
    mapper, point_of = start(world, sightings)
    m = mapper.map
    old = m.n_points
    mapper.insert(next_frame(mapper, point_of, sightings[3]))
    new = m.points()
    new = new[new >= old]
    a = m.arrays
    unfound, found, established = new[::3], new[1::3], m.points()[:50]
    a.pt_visible[new] = a.pt_found[new] = 10
    a.pt_found[unfound] = 1
    a.pt_visible[established], a.pt_found[established] = 10, 1
    mapper.insert(next_frame(mapper, point_of, sightings[4]))
    check_map(m)
    unfound = unfound[a.pt_replaced[unfound] < 0]
    assert len(unfound) > 50
    assert a.pt_bad[unfound].all()
    assert (a.pt_bad[found] & (a.pt_replaced[found] < 0)).mean() < 0.1
    # Only young points are checked.
    assert (a.pt_bad[established] & (a.pt_replaced[established] < 0)).mean() < 0.1


def test_points_without_a_third_observer_are_dropped_in_time(world, sightings):
    mapper, point_of = start(world, sightings)
    m = mapper.map
    old = m.n_points
    mapper.insert(next_frame(mapper, point_of, sightings[3]))
    a = m.arrays
    new = m.points()
    new = new[new >= old]
    # Observed by two, and without a match in a third one.
    lonely = new[a.pt_observations[new] == 2]
    assert len(lonely) > 20
    ids, _ = world_ids(m, sightings[:4])
    young = []
    for k in (4, 5):
        seen = sightings[k]
        other = seen.frame.features.descriptors.copy()
        other[np.isin(seen.ids, ids[lonely])] ^= np.uint64(2**64 - 1)
        changed = replace(seen.frame.features, descriptors=other)
        mapper.insert(next_frame(mapper, point_of, replace(seen, frame=Frame(changed))))
        check_map(m)
        young.append((~m.arrays.pt_bad[lonely]).sum())
    assert young[0] > 0
    assert young[1] == 0


# -- absorption ----------------------------------------------------------------------------------------------


def test_mapping_continues_in_a_map_that_has_absorbed_its_own(world, sightings):
    mapper, point_of = start(world, sightings)
    mapper.insert(next_frame(mapper, point_of, sightings[3]))
    other, _ = world.map_of(sightings[-3:], np.random.default_rng(16), map_id=1)
    keyframes, points = other.absorb(mapper.map)
    other.set_parent(keyframes, 0)
    mapper.rebase(other)
    assert not len(mapper._young)
    shifted = np.where(point_of >= 0, point_of + points, -1)
    frame = tracked_in(other, shifted, sightings[4], keyframes + 3)
    frame.point[frame.point >= 0] = np.where(
        other.arrays.pt_bad[frame.point[frame.point >= 0]], -1, frame.point[frame.point >= 0]
    )
    row = mapper.insert(frame)
    check_map(other)
    assert row == other.n_keyframes - 1
    assert len(other.points()) > len(mapper._young) > 0


def test_a_local_problem_lists_every_observation_of_the_free_keyframes_points():
    m = random_map(np.random.default_rng(6), keyframes=7, points=100)
    free = np.zeros(7, bool)
    free[[1, 3]] = True
    cameras, points, obs_camera, obs_point, obs_keypoint = local_problem(m.arrays, 7, m.n_points, free, 10)
    owned = np.concatenate([m.observed_points(1), m.observed_points(3)])
    assert set(points.tolist()) == set(owned[owned >= 0].tolist())
    assert set(cameras[:2].tolist()) == {1, 3}
    np.testing.assert_array_equal(m.arrays.kp_point[obs_keypoint], points[obs_point])
    np.testing.assert_array_equal(m.arrays.kp_keyframe[obs_keypoint], cameras[obs_camera])
    assert len(obs_keypoint) == m.arrays.pt_observations[points].sum()
