"""The map keeps its invariants under every operation."""

import numpy as np
import pytest
from slam_scenes import FPS, VIEW, random_map

from dslab.slam.config import SlamConfig
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.invariants import check_map
from dslab.slam.map.map import MIN_OBSERVATIONS, Map
from dslab.slam.map_store import MapStore


def test_invariants_hold_after_random_edits():
    rng = np.random.default_rng(1)
    m = random_map(rng)
    check_map(m)
    for _ in range(150):
        good = m.points()
        if len(good) < 4:
            break
        edit = rng.integers(4)
        if edit == 0:
            kernels.remove_point(m.arrays, rng.choice(good))
        elif edit == 1:
            kernels.replace_point(m.arrays, *rng.choice(good, 2, replace=False).astype(np.int32), VIEW)
        elif edit == 2:
            rows = np.flatnonzero(m.arrays.kp_point[: m.arrays.kf_start[m.n_keyframes]] >= 0)
            kernels.erase_observation(m.arrays, rng.choice(rows), MIN_OBSERVATIONS)
        else:
            kernels.add_observation(m.arrays, rng.integers(0, m.arrays.kf_start[6]), rng.choice(good))
        check_map(m)


def test_the_check_reports_a_broken_association():
    m = random_map(np.random.default_rng(2))
    row = np.flatnonzero(m.arrays.kp_point[: m.arrays.kf_start[m.n_keyframes]] >= 0)[0]
    m.arrays.kp_point[row] = -1
    with pytest.raises(AssertionError):
        check_map(m)


def test_a_keyframe_observes_a_point_once():
    m = random_map(np.random.default_rng(3))
    p = int(m.points()[0])
    keyframe = int(m.arrays.kp_keyframe[m.arrays.pt_head[p]])
    free = m.keypoints(keyframe).start + np.flatnonzero(m.observed_points(keyframe) < 0)[0]
    assert not kernels.add_observation(m.arrays, free, p)
    check_map(m)


def test_replacement_is_followed_by_frames():
    m = random_map(np.random.default_rng(4))
    a, b, c, d = m.points()[:4].astype(np.int32)
    kernels.replace_point(m.arrays, a, b, VIEW)
    kernels.replace_point(m.arrays, b, c, VIEW)
    kernels.remove_point(m.arrays, d)
    frame_points = np.array([a, b, c, d, -1], np.int32)
    kernels.resolve_points(m.arrays, frame_points)
    assert frame_points.tolist() == [c, c, c, -1, -1]


def test_a_culled_keyframe_follows_its_parent():
    m = random_map(np.random.default_rng(5))
    before = m.T_cam_map(3) @ np.linalg.inv(m.T_cam_map(2))
    m.cull_keyframe(3)
    check_map(m)
    assert m.parent(4) == 2
    m.arrays.kf_T_cam_map[2, :3, 3] += (1.0, 2.0, 3.0)
    np.testing.assert_allclose(m.T_cam_map(3), before @ m.T_cam_map(2), atol=1e-12)


def test_a_culled_keyframe_releases_its_features():
    m = random_map(np.random.default_rng(5))
    kept, others = m.features(3), [m.features(k) for k in (2, 4)]
    m.cull_keyframe(3)
    gone = m.features(3)
    assert (gone.index, gone.stamp_s) == (kept.index, kept.stamp_s) == (m.frame_index(3), 3 / FPS)
    assert len(gone) == 0 and gone.nbytes == 0 and len(kept) > 0
    assert all(array.base is None for array in (gone.xy, gone.xy_image, gone.descriptors, gone.cell_start))
    assert [m.features(k) for k in (2, 4)] == others


def test_transform_moves_points_and_cameras_together():
    rng = np.random.default_rng(6)
    m = random_map(rng)
    m.cull_keyframe(2)
    p = m.points()
    seen_before = [m.arrays.pt_xyz[p] @ m.T_cam_map(k)[:3, :3].T + m.T_cam_map(k)[:3, 3] for k in range(6)]
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    Q *= np.linalg.det(Q)
    m.transform(2.5, Q, np.array([1.0, -2.0, 0.5]))
    for k in range(6):
        seen = m.arrays.pt_xyz[p] @ m.T_cam_map(k)[:3, :3].T + m.T_cam_map(k)[:3, 3]
        np.testing.assert_allclose(seen, 2.5 * seen_before[k], atol=1e-9)


def test_absorb_keeps_both_maps_valid():
    rng = np.random.default_rng(7)
    a, b = random_map(rng), random_map(rng, keyframes=5, points=60, map_id=1)
    b.cull_keyframe(2)
    xyz_b, T_b = b.arrays.pt_xyz[b.points()].copy(), [b.T_cam_map(k) for k in range(5)]
    count = len(a.points()) + len(b.points())
    keyframes, points = a.absorb(b)
    check_map(a)
    check_map(b)
    assert len(a.points()) == count
    np.testing.assert_array_equal(a.arrays.pt_xyz[b.points() + points], xyz_b)
    for k in range(5):
        np.testing.assert_array_equal(a.T_cam_map(k + keyframes), T_b[k])


def test_a_copy_is_independent():
    m = random_map(np.random.default_rng(8))
    copied = m.copy()
    kernels.remove_point(copied.arrays, int(copied.points()[0]))
    copied.cull_keyframe(3)
    check_map(m)
    check_map(copied)
    assert len(m.keyframes()) == len(copied.keyframes()) + 1


def test_the_representative_descriptor_is_nearest_to_all():
    rng = np.random.default_rng(9)
    m = random_map(rng, keyframes=8, points=40)
    for p in m.points():
        rows, e = [], int(m.arrays.pt_head[p])
        while e >= 0:
            rows.append(e)
            e = int(m.arrays.kp_next[e])
        kernels.refresh_point(m.arrays, int(p), VIEW)
        d = m.arrays.kp_descriptor[rows]
        distance = np.bitwise_count(d[:, None] ^ d[None]).sum(-1)
        sums = distance.sum(1)
        chosen = [int(np.bitwise_count(x ^ m.arrays.pt_descriptor[p]).sum()) for x in d].index(0)
        assert sums[chosen] == sums.min()


def arrays_of(m):
    return [array.tobytes() for array in m.arrays]


def test_replacing_points_together_equals_one_by_one():
    """Including chains and repetitions; -1 keeps a point."""
    rng = np.random.default_rng(6)
    at_once = random_map(rng)
    one_by_one = at_once.copy()
    olds = rng.choice(at_once.points(), 40).astype(np.int32)
    news = np.where(rng.random(40) < 0.2, -1, rng.choice(at_once.points(), 40)).astype(np.int32)
    kernels.replace_points(at_once.arrays, olds, news, VIEW)
    for old, new in zip(olds, news, strict=True):
        if new >= 0:
            kernels.replace_point(one_by_one.arrays, old, new, VIEW)
    assert arrays_of(at_once) == arrays_of(one_by_one)
    check_map(at_once)


def test_taking_over_points_together_equals_one_by_one():
    """Free keypoints observe them; points of occupied keypoints are joined."""
    rng = np.random.default_rng(7)
    at_once = random_map(rng)
    one_by_one = at_once.copy()
    keyframe, start = 2, at_once.keypoints(2).start
    count = len(at_once.observed_points(keyframe))
    points = np.where(rng.random(count) < 0.5, -1, rng.choice(at_once.points(), count)).astype(np.int32)
    kernels.take_over(at_once.arrays, keyframe, points, VIEW)
    own = one_by_one.observed_points(keyframe)
    joined = 0
    for row in np.flatnonzero(points >= 0).tolist():
        point = points[row]
        if own[row] >= 0:
            joined += 1
            kernels.replace_point(one_by_one.arrays, point, own[row], VIEW)
        elif kernels.add_observation(one_by_one.arrays, start + row, point):
            kernels.refresh_point(one_by_one.arrays, point, VIEW)
    assert joined > 3
    assert arrays_of(at_once) == arrays_of(one_by_one)
    check_map(at_once)


def test_keypoints_of_a_new_map_are_as_noisy_as_those_of_the_last_one():
    store = MapStore(SlamConfig())
    first, second = Map(0, VIEW), Map(1, VIEW)
    store.add(first)
    for variance in (0.2, np.nan, 0.4):
        first.noise.note(variance)
    assert first.noise2 == pytest.approx(0.3)  # the first that is told counts alone
    store.add(second)
    assert second.noise2 == pytest.approx(0.3)
    second.noise.note(0.9)
    assert second.noise2 == pytest.approx(0.5) and first.noise2 == pytest.approx(0.3)


def test_a_point_is_redundant_if_others_know_three_times_as_much_of_it():
    """On the same or a finer level each counts 1, on a coarser one nothing, or by its information."""
    m = random_map(np.random.default_rng(12), keyframes=8, points=40)
    a, found = m.arrays, set()
    for k in range(8):
        own = np.flatnonzero(m.observed_points(k) >= 0) + m.keypoints(k).start
        for coarser in (False, True):
            redundant = []
            for e in own:
                others = np.flatnonzero(a.kp_point[: a.kf_start[8]] == a.kp_point[e])
                others = others[others != e]
                worth = VIEW.inv_sigma2[a.kp_octave[others]] / VIEW.inv_sigma2[a.kp_octave[e]]
                worth = np.minimum(worth, 1.0) if coarser else (worth >= 1.0)
                redundant.append(worth.sum() >= 3.0)
            expected = np.mean(redundant) if len(own) else 0.0
            assert kernels.redundant_share(a, k, coarser, VIEW) == pytest.approx(expected)
            found.add((coarser, float(expected)))
    assert len(found) > 6
