"""The published search finds again what a scene shows, and only there."""

import numpy as np
import pytest
from slam_scenes import VIEW, make_frame, random_map, rigid, scene, seen_from

from dslab.slam.core.frame import Frame
from dslab.slam.map._local_map_kernels import local_keyframes, points_seen
from dslab.slam.map.invariants import check_map
from dslab.slam.matching.window import nearest
from dslab.slam.published._search_kernels import (
    GUIDED_BITS,
    expected_at,
    search_keyframe,
    search_last_frame,
    search_local_map,
)


def nearest_reference(f, u, v, radius, finest, coarsest, query):
    bits = np.bitwise_count(f.descriptors ^ query).sum(1).astype(int)
    near = (((f.xy - (u, v)) ** 2).sum(1) <= radius**2) & (f.octave >= finest) & (f.octave <= coarsest)
    return bits, near


def test_the_nearest_in_a_circle_agrees_with_numpy():
    rng = np.random.default_rng(0)
    f = make_frame(0, rng, n=900).features
    hits = 0
    for round_ in range(400):
        query = f.descriptors[rng.integers(len(f))] ^ np.uint64(2 ** int(rng.integers(60)))
        out = 3000 if round_ % 4 == 0 else 40
        u, v = rng.uniform((-out, -out), (640 + out, 480 + out))
        radius, finest = rng.uniform(5, 120), rng.uniform(-1, 5)
        args = (float(u), float(v), float(radius), finest, finest + 2, query)
        i, best = nearest(VIEW, f.xy, f.octave, f.descriptors, f.cell_start, 0, *args)
        bits, near = nearest_reference(f, *args)
        assert best == min(bits[near], default=257)
        assert i < 0 if best == 257 else (near[i] and bits[i] == best)
        hits += i >= 0
    assert hits > 100


@pytest.fixture
def seen():
    """A map, its keyframe's frame, and what another camera sees of it."""
    m, frame = scene(np.random.default_rng(2))
    m.arrays.pt_max_distance[: m.n_points] = (
        np.linalg.norm(m.arrays.pt_xyz[: m.n_points], axis=1) * VIEW.scale[frame.features.octave]
    )
    T = rigid((-0.1, 0.02, 0.05), (0, 3, 0))
    return m, frame, T, *seen_from(m, frame, T)


def named(current, truth):
    return np.array([truth[tuple(d)] for d in current.features.descriptors.tolist()])


def test_points_of_the_last_frame_are_found_again(seen):
    m, frame, T, current, truth = seen
    f = current.features
    args = frame.point, frame.features.octave, f.xy, f.octave, f.descriptors, f.cell_start
    point = search_last_frame(m.arrays, VIEW, T, *args, 5.0)
    assert (point == named(current, truth)).mean() > 0.98
    assert (search_last_frame(m.arrays, VIEW, rigid((-0.6, 0, 0)), *args, 5.0) >= 0).mean() < 0.1


def test_a_keypoint_that_looks_like_two_points_is_that_which_it_looks_more_like(seen):
    m, frame, T, current, _ = seen
    f = current.features
    double = m.create_point(m.arrays.pt_xyz[frame.point[0]], m.keypoints(0).start)
    last = np.append(frame.point, np.int32(double))
    octave = np.append(frame.features.octave, frame.features.octave[0])
    m.arrays.pt_descriptor[double] = m.arrays.pt_descriptor[frame.point[0]] ^ np.uint64(7)
    for order in (slice(None), slice(None, None, -1)):
        point = search_last_frame(
            m.arrays, VIEW, T, np.ascontiguousarray(last[order]), np.ascontiguousarray(octave[order]),
            f.xy, f.octave, f.descriptors, f.cell_start, 5.0,
        )  # fmt: skip
        assert double not in point and frame.point[0] in point


def test_local_points_are_found_at_unmatched_keypoints_and_counted_as_visible(seen):
    m, frame, T, current, truth = seen
    f, right = current.features, named(current, truth)
    point = np.where(np.arange(len(f)) % 2, right, -1).astype(np.int32)
    kept = point.copy()
    search_local_map(
        m.arrays, VIEW, T, frame.point, f.xy, f.octave, f.descriptors, f.cell_start, point, 4.0, True
    )
    assert (point[kept >= 0] == kept[kept >= 0]).all()
    inner = ((f.xy > 40) & (f.xy < (600, 440))).all(1)
    assert (point == right)[inner].mean() > 0.95
    assert (m.arrays.pt_visible[right[inner]] == 2).mean() > 0.95


def test_what_looks_otherwise_or_cannot_be_seen_is_not_found(seen):
    m, frame, T, current, _ = seen
    f, point = current.features, np.full(len(current.features), -1, np.int32)
    m.arrays.pt_descriptor[: m.n_points] ^= np.uint64(2**32 - 1)  # 128 bits, four words of 32
    assert GUIDED_BITS < 128
    args = f.xy, f.octave, f.descriptors, f.cell_start, point
    search_local_map(m.arrays, VIEW, T, frame.point, *args, 4.0, False)
    assert (point >= 0).mean() < 0.05


def test_a_view_does_not_expect_points_beyond_its_limits(seen):
    m, frame, *_ = seen
    p = int(frame.point[0])
    here = m.arrays.pt_xyz[p].copy()
    assert not np.isnan(expected_at(m.arrays, VIEW, np.eye(4), p)[2])
    normal, far = m.arrays.pt_normal[p].copy(), float(m.arrays.pt_max_distance[p])
    m.arrays.pt_normal[p] = -normal
    assert np.isnan(expected_at(m.arrays, VIEW, np.eye(4), p)[2])
    m.arrays.pt_normal[p] = normal
    for factor in (0.8, 1.25 * VIEW.scale[-1]):  # nearer than the coarsest level, or beyond the finest
        m.arrays.pt_max_distance[p] = factor * np.linalg.norm(here)
        assert np.isnan(expected_at(m.arrays, VIEW, np.eye(4), p)[2])
    m.arrays.pt_max_distance[p] = far
    m.arrays.pt_xyz[p] = -here
    assert np.isnan(expected_at(m.arrays, VIEW, np.eye(4), p)[2])


def test_points_that_are_one_become_one_in_a_keyframe():
    m, frame = scene(np.random.default_rng(5), n=150)
    m.arrays.pt_max_distance[: m.n_points] = (
        np.linalg.norm(m.arrays.pt_xyz[: m.n_points], axis=1) * VIEW.scale[frame.features.octave]
    )
    again = Frame(frame.features)
    again.T_cam_map = np.eye(4)
    second = m.add_keyframe(again, 0)
    start = m.keypoints(second).start
    doubles = [m.create_point(m.arrays.pt_xyz[frame.point[i]] * 1.0005, start + i) for i in range(50)]
    search_keyframe(m.arrays, VIEW, second, frame.point, 3.0)
    check_map(m)
    assert (m.arrays.pt_bad[doubles]).sum() + (m.arrays.pt_bad[frame.point[:50]]).sum() >= 45
    assert m.arrays.covisibility[0, second] >= 140


def test_the_local_map_has_what_shares_points_and_then_what_shares_most_with_that():
    m = random_map(np.random.default_rng(4), keyframes=12, points=80)
    n = m.n_keyframes
    point = m.points()[:2].astype(np.int32)
    sees = np.array([np.isin(point, m.observed_points(k)).sum() for k in range(n)])
    first = int((sees > 0).sum())
    assert 0 < first < n
    every = local_keyframes(m.arrays, n, point, 1, 100)
    assert set(every[:first].tolist()) == set(np.flatnonzero(sees))
    assert sees[every[0]] == sees.max()
    shared = m.arrays.covisibility[:n, :n][every[:first]].max(axis=0)[every[first:]]
    assert (np.diff(shared) <= 0).all() and (shared > 0).all()
    assert len(local_keyframes(m.arrays, n, point, int(shared.max()) + 1, 100)) == first
    np.testing.assert_array_equal(local_keyframes(m.arrays, n, point, 1, first + 1), every[: first + 1])
    owned = np.concatenate([m.observed_points(int(k)) for k in every])
    points = points_seen(m.arrays, m.n_points, every)
    assert sorted(points.tolist()) == sorted(set(owned[owned >= 0].tolist()))
