"""How well a frame is known relative to a keyframe: against the whole problem written out."""

import numpy as np
import pytest
from slam_scenes import PointWorld, tracked_in, walk

from dslab.slam.map._covariance_kernels import relative_covariance


@pytest.fixture(scope="module")
def built():
    world, rng = PointWorld(seed=3), np.random.default_rng(4)
    sightings = [world.see(i, walk(i), rng, noise_px=0.5) for i in range(0, 16, 5)]
    map_, point_of = world.map_of(sightings[:3], rng)
    return map_, tracked_in(map_, point_of, sightings[3], 2)


def found(map_, frame, rows, keyframe=2):
    return relative_covariance(
        map_.arrays, map_.view, map_.n_keyframes, keyframe, frame.T_cam_map, frame.point[rows],
        frame.features.octave[rows], 0.5, 0.25,
    )  # fmt: skip


def jacobians(view, T, xyz):
    x, y, z = T[:3, :3] @ xyz + T[:3, 3]
    of_point = np.array([[view.fx, 0, -view.fx * x / z], [0, view.fy, -view.fy * y / z]]) / z
    skew = np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])  # of exp(twist) T, by its rotation
    return np.hstack([of_point, of_point @ skew]), of_point @ T[:3, :3]


def test_it_is_the_block_of_the_inverse_of_the_whole_information(built):
    map_, frame = built
    rows = np.flatnonzero(frame.point >= 0)[:40]
    a, view, points = map_.arrays, map_.view, frame.point[rows]
    free = {0: 6, 1: 12}  # column of each keyframe that is not held; the frame's is 0
    H = np.zeros((18 + 3 * len(points),) * 2)
    for n, p in enumerate(points):
        seen = [(frame.T_cam_map, 0, view.inv_sigma2[frame.features.octave[rows[n]]] / 0.25)]
        e = int(a.pt_head[p])
        while e >= 0:
            k = int(a.kp_keyframe[e])
            seen.append((map_.T_cam_map(k), free.get(k), view.inv_sigma2[a.kp_octave[e]] / 0.5))
            e = int(a.kp_next[e])
        for T, column, weight in seen:
            of_camera, of_point = jacobians(view, T, a.pt_xyz[p])
            J = np.zeros((2, len(H)))
            J[:, 18 + 3 * n : 21 + 3 * n] = of_point
            if column is not None:
                J[:, column : column + 6] = of_camera
            H += weight * J.T @ J
    centre = [np.linalg.inv(map_.T_cam_map(k))[:3, 3] for k in range(3)]
    length = np.linalg.norm(centre[0] - centre[2])
    held = np.zeros(len(H))
    held[6:9] = map_.T_cam_map(0)[:3, :3] @ (centre[0] - centre[2]) / length
    H += np.outer(held, held) / (1e-3 * length) ** 2
    expected = np.linalg.inv(H)[:6, :6]
    scale = np.sqrt(np.diag(expected))
    difference = (found(map_, frame, rows) - expected) / np.outer(scale, scale)
    assert np.abs(difference).max() < 1e-4


def test_more_points_tell_more_and_too_few_nothing(built):
    map_, frame = built
    rows = np.flatnonzero(frame.point >= 0)
    some, all_ = (np.trace(found(map_, frame, rows[:n])[3:, 3:]) for n in (30, len(rows)))
    assert all_ < 0.5 * some
    assert np.isinf(found(map_, frame, rows[:2])).all()
