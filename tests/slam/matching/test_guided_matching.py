"""Guided matching agrees with plain NumPy on random scenes."""

import numpy as np
from slam_scenes import VIEW, make_frame, random_map, scene, seen_from

from dslab.slam.core.frame import Frame
from dslab.slam.map.invariants import check_map
from dslab.slam.mapping._local_problem import local_problem
from dslab.slam.matching import guided


def nearest_in_window_reference(features, taken, u, v, radius, low, high, query, ratio):
    """Search over every keypoint, in the order of the frame's rows."""
    distance = np.bitwise_count(features.descriptors ^ query).sum(1).astype(int)
    near = (np.abs(features.xy - (u, v)) <= radius).all(1) & ~taken
    near &= (features.octave >= low) & (features.octave <= high)
    rows = np.flatnonzero(near)
    if not len(rows):
        return -1, 257
    order = rows[np.argsort(distance[rows], kind="stable")]
    best = order[0]
    if len(order) > 1:
        second = order[1]
        same_level = features.octave[best] == features.octave[second]
        if same_level and distance[best] > ratio * distance[second]:
            return -1, 257
    return int(best), int(distance[best])


def test_the_window_search_agrees_with_numpy():
    rng = np.random.default_rng(0)
    f = make_frame(0, rng, n=900).features
    hits = 0
    for round_ in range(400):
        query = f.descriptors[rng.integers(len(f))] ^ np.uint64(2 ** int(rng.integers(60)))
        out = 3000 if round_ % 4 == 0 else 40
        u, v = rng.uniform((-out, -out), (640 + out, 480 + out))
        radius, low = rng.uniform(5, 120), int(rng.integers(-1, 5))
        taken = rng.random(len(f)) < 0.1
        args = (float(u), float(v), float(radius), low, low + 2, query, float(rng.uniform(0.6, 1.0)))
        got = guided.nearest_in_window(VIEW, f.xy, f.octave, f.descriptors, f.cell_start, 0, taken, *args)
        expected = nearest_in_window_reference(f, taken, *args)
        assert got[0] == expected[0] or got[1] == expected[1] < 257
        hits += got[0] >= 0
    assert hits > 100


def moved_camera():
    T = np.eye(4)
    c, s = np.cos(0.05), np.sin(0.05)
    T[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    T[:3, 3] = -0.1, 0.02, 0.05
    return T


def test_points_of_the_last_frame_are_found_again():
    m, frame = scene(np.random.default_rng(1))
    T = moved_camera()
    current, truth = seen_from(m, frame, T)
    g, f = frame.features, current.features
    point, count = guided.match_last_frame(
        m.arrays, VIEW, T, frame.point, g.octave, g.angle_deg,
        f.xy, f.octave, f.angle_deg, f.descriptors, f.cell_start, 5.0,
    )  # fmt: skip
    assert count == (point >= 0).sum() >= 0.98 * len(f)
    for row in np.flatnonzero(point >= 0):
        assert point[row] == truth[tuple(f.descriptors[row].tolist())]


def test_local_points_are_found_and_counted_as_visible():
    m, frame = scene(np.random.default_rng(2))
    m.arrays.pt_max_distance[: m.n_points] = (
        np.linalg.norm(m.arrays.pt_xyz[: m.n_points], axis=1) * (VIEW.scale[frame.features.octave])
    )
    current, truth = seen_from(m, frame, np.eye(4))
    f = current.features
    point = np.full(len(f), -1, np.int32)
    expected, added = guided.match_local_points(
        m.arrays,
        VIEW,
        np.eye(4),
        frame.point,
        f.xy,
        f.octave,
        f.descriptors,
        f.cell_start,
        point,
        1.0,
        0.8,
        True,
    )
    assert expected >= 0.98 * len(f) and added >= 0.95 * len(f)
    for row in np.flatnonzero(point >= 0):
        assert point[row] == truth[tuple(f.descriptors[row].tolist())]
    assert (m.arrays.pt_visible[frame.point] == 2).sum() == expected


def test_duplicates_of_a_keyframe_are_fused():
    m, frame = scene(np.random.default_rng(5), n=150)
    m.arrays.pt_max_distance[: m.n_points] = (
        np.linalg.norm(m.arrays.pt_xyz[: m.n_points], axis=1) * (VIEW.scale[frame.features.octave])
    )
    again = Frame(frame.features)
    again.T_cam_map = np.eye(4)
    second = m.add_keyframe(again, 0)
    start = m.keypoints(second).start
    doubles = [m.create_point(m.arrays.pt_xyz[frame.point[i]] * 1.0005, start + i) for i in range(50)]
    guided.fuse_into_keyframe(m.arrays, VIEW, second, frame.point, 3.0)
    check_map(m)
    assert (m.arrays.pt_bad[doubles]).sum() + (m.arrays.pt_bad[frame.point[:50]]).sum() >= 45
    assert m.arrays.covisibility[0, second] >= 140


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
