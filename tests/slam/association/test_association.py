"""Windows hold the share of right keypoints that they promise, and a pair is taken by its posterior."""

import numpy as np
import pytest
from slam_scenes import CAMERA, VIEW, PointWorld, pose_error, rigid, scene, seen_from, tracked_in, walk

from dslab.slam.association._kernels import associate, density_of
from dslab.slam.association._mapping_kernels import fuse_points, points_along_rays
from dslab.slam.association.descriptors import odds_by_distance
from dslab.slam.core.frame import Features, Frame, FrameFeatures
from dslab.slam.map._map_kernels import add_observation, erase_observation, observed_in, remove_point
from dslab.slam.map.invariants import check_map
from dslab.slam.mapping.local_mapping import LocalMappingConfig
from dslab.slam.mapping.rules import map_rules
from dslab.slam.optimization._se3 import retract
from dslab.slam.optimization.student import TAILS

IMAGE_PX2 = 640.0 * 480.0


def found_in(m, frame, T, covariance, noise2=1.0, least=0.5):
    f = frame.features
    points = m.points().astype(np.int32)
    return associate(
        m.arrays, VIEW, np.ascontiguousarray(T), covariance, noise2, points, f.xy, f.octave, f.descriptors,
        f.cell_start, density_of(f.octave, 8, IMAGE_PX2), odds_by_distance(), least, False,
    )  # fmt: skip


def student(rng, n):
    """(n, 2) errors of unit variance, with the tails of right matches."""
    return rng.normal(size=(n, 2)) * np.sqrt((TAILS - 2) / rng.chisquare(TAILS, n))[:, None]


def of_keyframes(world, rng, frames, noise_px=0.5):
    sightings = [world.see(i, walk(i), rng, noise_px=noise_px, bits=8) for i in frames]
    return sightings, *world.map_of(sightings, rng)


@pytest.mark.parametrize(("deviation", "most"), [(0.0, 0.998), (0.004, 0.998), (0.02, 1.0)])
def test_windows_of_99_percent_hold_the_share_of_right_keypoints_that_they_promise(deviation, most):
    rng = np.random.default_rng(1)
    m, frame = scene(rng)
    covariance = np.diag(np.r_[np.full(3, deviation * 5), np.full(3, deviation)] ** 2)
    right, expected, T = 0, 0, np.eye(4)
    m.arrays.pt_covariance[:] = 0.0  # the points are exact
    for _ in range(20):
        other, truth = seen_from(m, frame, np.eye(4))
        f = other.features
        f.xy.setflags(write=True)
        f.xy[:] += student(rng, len(f)) / np.sqrt(VIEW.inv_sigma2[f.octave])[:, None]
        retract(np.eye(4), np.linalg.cholesky(covariance + 1e-18 * np.eye(6)) @ rng.normal(size=6), T)
        point, *_ = found_in(m, other, T, covariance)
        ids = np.array([truth[tuple(d)] for d in f.descriptors.tolist()])
        inner = (f.xy > 60).all(1) & (f.xy < (580, 420)).all(1)
        right += (point == ids)[inner].sum()
        expected += inner.sum()
    assert 0.98 < right / expected <= most  # the wider the pose's part, the less tail has the sum


def test_without_the_poses_covariance_a_pose_that_is_off_finds_little():
    m, frame = scene(np.random.default_rng(2))
    other, _ = seen_from(m, frame, np.eye(4))
    off = rigid(rotvec_deg=(0, 1.5, 0))  # 13 px
    covariance = np.diag([1e-6] * 3 + [np.deg2rad(1.5) ** 2] * 3)
    without, with_it = ((found_in(m, other, off, of)[0] >= 0).sum() for of in (np.zeros((6, 6)), covariance))
    assert without < 0.5 * with_it and with_it > 300


def test_of_two_keypoints_that_look_alike_the_nearer_is_taken_or_none():
    m, frame = scene(np.random.default_rng(3), n=60)
    other, truth = seen_from(m, frame, np.eye(4))
    f = other.features
    for array in (f.xy, f.descriptors, f.octave):
        array.setflags(write=True)
    f.octave[:] = 0
    m.arrays.pt_max_distance[m.points()] = np.linalg.norm(m.arrays.pt_xyz[m.points()], axis=1)
    m.arrays.pt_covariance[:] = 0.0
    wide = np.diag([1e-12] * 3 + [np.deg2rad(0.5) ** 2] * 3)
    i = int(np.argsort(np.abs(f.xy - (320, 240)).max(1))[0])
    j = (i + 1) % len(f)
    f.descriptors[j] = f.descriptors[i]
    for apart, taken in ((0.4, False), (12.0, True)):
        f.xy[j] = f.xy[i] + (apart, 0.0)
        point, *_ = found_in(m, in_cells(other), np.eye(4), wide, least=0.9)
        assert (truth[tuple(f.descriptors[i].tolist())] in point) == taken


def in_cells(frame):
    """The frame with its keypoints sorted into cells again."""
    f = frame.features
    ones = np.ones(len(f), np.float32)
    features = Features(f.xy.astype(np.float32), f.octave, f.angle_deg, ones, f.descriptors)
    return Frame(FrameFeatures.build(f.index, f.stamp_s, features, CAMERA, VIEW))


def test_new_points_are_where_the_world_has_them_and_those_without_parallax_are_not_made():
    rng, world = np.random.default_rng(4), PointWorld(seed=5)
    sightings, m, _ = of_keyframes(world, rng, (0, 10))
    ids = np.concatenate([s.ids for s in sightings])
    for p in m.points()[::2]:  # half of the map is to be found again
        remove_point(m.arrays, int(p))
    density = density_of(m.arrays.kp_octave[m.keypoints(1)], 8, IMAGE_PX2)

    def made(max_error, expected_m):
        expected = np.tile([expected_m, 0.3, 0.2], (len(sightings[0].ids), 1))
        return points_along_rays(
            m.arrays, VIEW, 0, 1, 0.25, 0.5, expected, max_error, density, odds_by_distance(), 0.9
        )

    own, theirs, xyz = made(0.15, 5.5)
    same = (ids[own] == ids[theirs]) & (ids[own] >= 0)
    assert len(own) > 80 and same.mean() > 0.97
    T = m.arrays.kf_T_cam_map[0]
    depth, true = (
        (points @ T[:3, :3].T + T[:3, 3])[:, 2] for points in (xyz[same], world.xyz[ids[own[same]]])
    )
    assert np.median(np.abs(depth / true - 1)) < 0.03
    assert len(made(0.15, 5000.0)[0]) == 0


def test_two_keypoints_of_one_corner_do_not_hide_it():
    rng, world = np.random.default_rng(4), PointWorld(seed=5, points=2000)
    for name in ("xyz", "descriptor", "angle_deg", "size"):
        setattr(world, name, np.repeat(getattr(world, name), 2, axis=0))
    sightings = [world.see(i, walk(i), rng, noise_px=0.5, share=1.0) for i in (0, 10)]
    m, _ = world.map_of(sightings, rng)
    ids = np.concatenate([np.where(s.ids >= 0, s.ids // 2, -1) for s in sightings])
    for p in m.points()[m.points() % 4 < 2]:  # both points of every second corner
        remove_point(m.arrays, int(p))
    expected = np.tile([5.5, 0.3, 0.2], (len(sightings[0].ids), 1))
    density = density_of(m.arrays.kp_octave[m.keypoints(1)], 8, IMAGE_PX2)
    own, theirs, _ = points_along_rays(
        m.arrays, VIEW, 0, 1, 0.25, 0.5, expected, 0.15, density, odds_by_distance(), 0.9
    )
    assert len(own) > 80 and (ids[own] == ids[theirs])[ids[own] >= 0].mean() > 0.97


def test_points_of_two_maps_that_are_one_become_one_and_others_do_not():
    rng, world = np.random.default_rng(6), PointWorld(seed=7)
    _, m, point_of = of_keyframes(world, rng, (0, 5, 10))
    k = m.add_keyframe(tracked_in(m, point_of, world.see(15, walk(15), rng, noise_px=0.5, bits=8), 2), 2)
    observed = m.observed_points(k)
    known = int((observed >= 0).sum())
    for row in np.flatnonzero(observed >= 0)[::2]:
        erase_observation(m.arrays, int(m.keypoints(k).start + row), 1)
    density = density_of(m.arrays.kp_octave[m.keypoints(k)], 8, IMAGE_PX2)
    done = fuse_points(m.arrays, VIEW, k, m.points().astype(np.int32), 0.25, density, odds_by_distance(), 0.9)
    check_map(m)
    assert done > 0.4 * known and (m.observed_points(k) >= 0).sum() > 0.9 * known
    assert pose_error(m.T_cam_map(k), walk(15))[0] < 1e-9


def test_a_view_speaks_for_its_place_and_against_another_one():
    rng, world = np.random.default_rng(8), PointWorld(seed=9)
    _, m, _ = of_keyframes(world, rng, (0, 5, 10))
    at_its_place = world.see(6, walk(6), rng, noise_px=0.5, bits=8, share=0.5)
    elsewhere = PointWorld(seed=10).see(6, walk(6), rng, noise_px=0.5, bits=8)
    for sighting, speaks in ((at_its_place, True), (elsewhere, False)):
        *_, evidence = found_in(m, sighting.frame, walk(6), 1e-6 * np.eye(6))
        assert (evidence > 20) if speaks else (evidence < 0)


def test_points_of_a_keyframe_are_sought_where_they_should_show_and_are_not_observed():
    rng, world = np.random.default_rng(11), PointWorld(seed=12)
    _, m, _ = of_keyframes(world, rng, (0, 3, 6, 9))
    by_all = [int(p) for p in m.points() if m.arrays.pt_observations[p] == 4]
    for p in set(m.points().tolist()) - set(by_all):
        remove_point(m.arrays, int(p))
    rules = map_rules(m, LocalMappingConfig())
    assert rules.targets(3) == []

    for k, missing in ((0, 20), (1, 30), (2, 15)):
        for p in by_all[:missing]:
            erased = int(observed_in(m.arrays, p, k))
            erase_observation(m.arrays, erased, 1)
    assert rules.targets(3) == [1, 0, 2]
    assert map_rules(m, LocalMappingConfig(neighbours=2)).targets(3) == [1, 0]
    add_observation(m.arrays, erased, by_all[14])
    assert rules.targets(3) == [1, 0]  # 15 points make a neighbour

    m.arrays.kf_T_cam_map[1] = rigid((0, 0, 0), (0, 180, 0)) @ m.arrays.kf_T_cam_map[1]
    assert rules.targets(3) == [0]  # what should not show is not missed


def test_a_larger_distance_of_descriptors_never_speaks_more_for_a_match():
    odds = odds_by_distance()
    assert odds[0] > 10 and odds[-1] < 1e-3 and (np.diff(odds) <= 0).all()
