"""Merging of a map extended forward with its copy extended backward."""

import numpy as np
import pytest
from slam_scenes import CAMERA, FPS, PointWorld, pose_error, rigid, tracked_in, walk

from dslab.slam.dual.fusion.merge_recovered import merge_recovered
from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryTask
from dslab.slam.dual.recovery.orb import OrbRecovery
from dslab.slam.map._map_kernels import add_observation
from dslab.slam.map.invariants import check_map
from dslab.slam.mapping.local_mapping import LocalMapper, LocalMappingConfig
from dslab.slam.optimization.sim3 import sim3_decompose, sim3_inverse, sim3_matrix

OLD = range(0, 35, 5)  # frames that are the old map's keyframes
FIRST, LAST = 45, 65  # frames of the new map when it is copied
SCALE = 0.5
MOVED = rigid((1.0, -2.0, 0.5), (10, -20, 15))
# Change of the map's gauge between copy and merge.
DRIFT = (1.1, rigid(rotvec_deg=(3, 5, -2))[:3, :3], np.array([0.4, -0.3, 0.2]))


@pytest.fixture(scope="module")
def world():
    return PointWorld(seed=31)


@pytest.fixture(scope="module")
def sightings(world):
    rng = np.random.default_rng(32)
    return [world.see(i, walk(i), rng, noise_px=0.4, bits=8) for i in range(86)]


def in_new_map(T_cam_world):
    """A pose of the world in the new map's frame and scale."""
    T = T_cam_world @ np.linalg.inv(MOVED)
    T[:3, 3] = SCALE * T_cam_world[:3, 3] - T[:3, :3] @ MOVED[:3, 3]
    return T


@pytest.fixture(scope="module")
def start_map(world, sightings):
    """The new map when it is copied, and its points by world point."""
    seen = [sightings[i] for i in range(FIRST, LAST + 1, 5)]
    built, point_of = world.map_of(seen, np.random.default_rng(34), noise=0.005, map_id=1)
    built.transform(SCALE, MOVED[:3, :3], MOVED[:3, 3])
    return built, point_of


@pytest.fixture(scope="module")
def recovered(world, sightings, start_map):
    """The copy, extended backward to the old map by a recovery."""
    old, _ = world.map_of([sightings[i] for i in OLD], np.random.default_rng(33), noise=0.005)
    built, point_of = start_map
    copy = built.copy()
    first = tracked_in(copy, point_of, sightings[FIRST], 0, copy.T_cam_map(0))
    step = copy.T_cam_map(0) @ np.linalg.inv(in_new_map(sightings[FIRST + 1].T_cam_world))
    backward = tuple(sightings[i].frame.features for i in range(FIRST - 1, -1, -1))
    result = OrbRecovery(RecoveryConfig()).run(
        RecoveryTask(copy, first, backward, [old], step, np.random.default_rng(0), CAMERA, lambda i: None)
    )
    assert result.success and result.confirming and len(result.frames) > 10 * result.keyframes_made / FPS
    return result


@pytest.fixture(scope="module")
def grown(sightings, start_map):
    """The same map, extended forward meanwhile, with another gauge and scale."""
    built, point_of = start_map
    forward = built.copy()
    mapper = LocalMapper(forward, LocalMappingConfig())
    for i in range(LAST + 5, 86, 5):
        T = in_new_map(sightings[i].T_cam_world)
        mapper.insert(tracked_in(forward, point_of, sightings[i], forward.n_keyframes - 1, T))
    forward.transform(*DRIFT)
    return forward


@pytest.fixture
def merged(grown, recovered, start_map):
    """The merged map, the position of the copy's rows, and both maps before."""
    forward, copy = grown.copy(), recovered.map.copy()
    rows = start_map[0].n_keyframes, start_map[0].n_points
    done = merge_recovered(forward, recovered.map.copy(), *rows)
    assert done is not None
    return forward, done, grown, copy, rows


S_DRIFT = sim3_matrix(*DRIFT)


def test_the_map_is_valid_and_has_the_keyframes_of_both(merged):
    m, done, grown, copy, (keyframes, _) = merged
    check_map(m)
    assert (done.keyframes, done.points) == (grown.n_keyframes, grown.n_points)
    frames = sorted(m.frame_index(int(k)) for k in m.keyframes())
    backward = [copy.frame_index(int(k)) for k in copy.keyframes() if k >= keyframes]
    assert len(backward) >= 2
    assert frames == sorted([*backward, *(grown.frame_index(int(k)) for k in grown.keyframes())])
    assert [k for k in range(m.n_keyframes) if m.parent(k) < 0] == [0]


def test_a_change_of_gauge_and_scale_meanwhile_is_compensated(merged, sightings):
    m, done, _, _, _ = merged
    assert sim3_decompose(done.S_map_copy)[0] == pytest.approx(DRIFT[0], rel=0.01)
    s, R, t = DRIFT
    for k in m.keyframes():
        T = in_new_map(sightings[m.frame_index(int(k))].T_cam_world)
        T_now = T.copy()
        T_now[:3, :3] = T[:3, :3] @ R.T
        T_now[:3, 3] = s * T[:3, 3] - T_now[:3, :3] @ t
        distance, angle = pose_error(m.T_cam_map(int(k)), T_now)
        assert distance < 0.04 * s and angle < 0.4, m.frame_index(int(k))


def test_no_common_point_is_lost(merged):
    m, done, grown, copy, (_, points) = merged
    both = ~grown.arrays.pt_bad[:points] & ~copy.arrays.pt_bad[:points]
    assert both.sum() > 200
    assert not m.arrays.pt_bad[:points][both].any()
    assert m.arrays.pt_bad[done.points : done.points + points][both].all()
    np.testing.assert_array_equal(m.arrays.pt_xyz[:points][both], grown.arrays.pt_xyz[:points][both])


def test_the_observations_of_both_are_kept(merged):
    m, done, grown, copy, (keyframes, _) = merged
    kept = observed = 0
    for k in range(grown.n_keyframes):
        before = grown.observed_points(k) >= 0
        assert (m.observed_points(k) >= 0)[before].all(), "what the map itself observed"
    for k in range(copy.n_keyframes):
        if k < keyframes and grown.arrays.kf_bad[k]:
            continue
        after = m.observed_points(k if k < keyframes else done.keyframes + k) >= 0
        before = copy.observed_points(k) >= 0
        kept += (after & before).sum()
        observed += before.sum()
    assert kept > 0.98 * observed
    # New and old parts are connected by the first keyframe's points, as in the copy.
    for k in range(keyframes, copy.n_keyframes):
        shared = m.arrays.covisibility[0, done.keyframes + k]
        assert shared >= 0.9 * copy.arrays.covisibility[0, k]


def test_the_alignment_is_transformed_too(merged, recovered, sightings):
    """It maps the present map to the old one, whose frame is the world's."""
    m, done, _, _, _ = merged
    for alignment in (*recovered.confirming, recovered.alignment):
        moved = done.moved(alignment, m)
        assert moved.scale == pytest.approx(1 / (SCALE * DRIFT[0]), rel=0.01)
        T_cam_map = m.T_cam_map(moved.new_keyframe)
        seen_from = moved.S_old_new @ np.linalg.inv(T_cam_map)
        frame = m.frame_index(moved.new_keyframe)
        centre = np.linalg.inv(sightings[frame].T_cam_world)[:3, 3]
        assert np.linalg.norm(seen_from[:3, 3] - centre) < 0.06
        assert not m.arrays.pt_bad[moved.new_points].any()
        assert moved.inliers > 0.95 * alignment.inliers
        expected = alignment.S_old_new @ sim3_inverse(done.S_map_copy)
        np.testing.assert_allclose(moved.S_old_new, expected, atol=1e-9)


def test_frames_of_a_keyframe_culled_in_the_copy_keep_their_poses(grown, recovered, start_map):
    forward, copy = grown.copy(), recovered.map.copy()
    for k in (1, 2):
        copy.cull_keyframe(k)
    backward = start_map[0].n_keyframes + 1
    copy.cull_keyframe(backward)
    before = {k: copy.T_cam_map(k) for k in (1, 2, backward)}
    done = merge_recovered(forward, copy, start_map[0].n_keyframes, start_map[0].n_points)
    assert done is not None
    check_map(forward)
    for k, T in before.items():
        S = T @ sim3_inverse(done.S_map_copy)
        expected = S.copy()
        expected[:3] *= sim3_decompose(done.S_map_copy)[0]
        distance, angle = pose_error(forward.T_cam_map(done.keyframes + k), expected)
        assert distance < 0.03 and angle < 0.3


def test_two_new_points_of_one_keypoint_are_joined(grown, recovered, start_map):
    forward, copy = grown.copy(), recovered.map.copy()
    rows = start_map[0].n_keyframes, start_map[0].n_points
    backward = int(copy.keyframes()[copy.keyframes() >= rows[0]][0])

    def free(m, k):
        return np.flatnonzero(m.observed_points(k) < 0)

    row = int(np.intersect1d(free(forward, 0), free(copy, 0))[0])
    own = forward.create_point(np.array([0.0, 0.0, 3.0]), forward.keypoints(0).start + row)
    add_observation(forward.arrays, forward.keypoints(1).start + int(free(forward, 1)[0]), own)
    theirs = copy.create_point(np.array([0.0, 0.0, 3.0]), copy.keypoints(0).start + row)
    seen = int(free(copy, backward)[0])
    add_observation(copy.arrays, copy.keypoints(backward).start + seen, theirs)
    done = merge_recovered(forward, copy, *rows)
    assert done is not None
    check_map(forward)
    assert forward.observed_points(0)[row] == own
    assert forward.observed_points(done.keyframes + backward)[seen] == own
    assert forward.arrays.pt_replaced[done.points + theirs] == own


def test_keyframes_culled_in_the_map_stay_culled(grown, recovered, start_map):
    forward = grown.copy()
    for k in (2, 3):
        forward.cull_keyframe(k)
    done = merge_recovered(forward, recovered.map.copy(), start_map[0].n_keyframes, start_map[0].n_points)
    assert done is not None
    check_map(forward)
    points = start_map[0].n_points
    both = shared(grown, recovered.map, points)
    both &= ~forward.arrays.pt_bad[:points]
    assert forward.arrays.pt_bad[done.points : done.points + points][both].all(), "no point comes back either"
    frame = forward.frame_index(2)
    assert frame not in [forward.frame_index(int(k)) for k in forward.keyframes()]
    distance, angle = pose_error(forward.T_cam_map(done.keyframes + 2), grown.T_cam_map(2))
    assert distance < 0.03 and angle < 0.3


def test_too_few_common_points_are_refused_without_changes(grown, recovered, start_map):
    forward, copy = grown.copy(), recovered.map.copy()
    forward.arrays.pt_bad[: start_map[0].n_points] = True
    before, theirs = forward.copy(), copy.copy()
    assert merge_recovered(forward, copy, start_map[0].n_keyframes, start_map[0].n_points) is None
    for one, other in ((forward, before), (copy, theirs)):
        assert one.n_keyframes == other.n_keyframes
        for x, y in zip(one.arrays, other.arrays, strict=True):
            np.testing.assert_array_equal(x, y)


def test_points_near_infinity_do_not_affect_the_similarity(grown, recovered, start_map):
    forward, copy = grown.copy(), recovered.map.copy()
    both = np.flatnonzero(shared(forward, copy, start_map[0].n_points))
    far = both[:: len(both) // 5]
    rng = np.random.default_rng(35)
    for arrays in (forward.arrays, copy.arrays):  # how far is anybody's guess
        arrays.pt_xyz[far] *= 1e6 * rng.uniform(0.5, 2.0, (len(far), 1))
    done = merge_recovered(forward, copy, start_map[0].n_keyframes, start_map[0].n_points)
    assert done is not None
    expected = merge_recovered(
        grown.copy(), recovered.map.copy(), start_map[0].n_keyframes, start_map[0].n_points
    )
    np.testing.assert_allclose(done.S_map_copy, expected.S_map_copy, atol=2e-3)


def test_collinear_points_are_refused(grown, recovered, start_map):
    forward, copy = grown.copy(), recovered.map.copy()
    both = shared(forward, copy, start_map[0].n_points)
    for arrays in (forward.arrays, copy.arrays):
        arrays.pt_xyz[: len(both)][both] = np.linspace(1.0, 2.0, both.sum())[:, None] * [1.0, 2.0, 3.0]
    assert merge_recovered(forward, copy, start_map[0].n_keyframes, start_map[0].n_points) is None


def shared(forward, copy, points):
    """Points that the map and its copy both still have."""
    return ~forward.arrays.pt_bad[:points] & ~copy.arrays.pt_bad[:points]
