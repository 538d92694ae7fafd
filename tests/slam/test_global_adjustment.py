"""An adjustment of the map as it was, applied to the map that it has grown into."""

import numpy as np
import pytest
from loop_scenes import ring
from slam_scenes import make_frame

from slam.global_adjustment import adjust_globally, apply_adjustment
from slam.loop_correction import correct_loop


@pytest.fixture
def closed():
    r = ring(keyframes=30)
    correct_loop(r.map, r.loop, r.loop_points)
    return r.map


def test_the_map_is_left_alone_until_it_is_applied(closed):
    before = [array.copy() for array in closed.arrays]
    adjustment = adjust_globally(closed)
    for old, new in zip(before, closed.arrays, strict=True):
        np.testing.assert_array_equal(old, new)
    apply_adjustment(closed, adjustment)
    closed.check()
    np.testing.assert_array_equal(closed.arrays.kf_T_cam_map[adjustment.keyframes], adjustment.T_cam_map)
    still = ~closed.arrays.pt_bad[adjustment.points]
    np.testing.assert_array_equal(closed.arrays.pt_xyz[adjustment.points[still]], adjustment.xyz[still])
    assert not (closed.arrays.kp_point[adjustment.outliers] == adjustment.of_points).any()


def test_what_has_come_since_follows_its_parent(closed):
    adjustment = adjust_globally(closed)
    parent = closed.n_keyframes - 1
    frame = make_frame(999, np.random.default_rng(0), T=np.linalg.inv(np.diag([1.0, 1, 1, 1])))
    frame.T_cam_map = closed.T_cam_map(parent) @ frame.T_cam_map
    k = closed.add_keyframe(frame, parent)
    row = closed.keypoints(k).start
    p = closed.create_point(np.linalg.inv(frame.T_cam_map)[:3] @ (0.1, 0.2, 3.0, 1.0), row)
    step = closed.T_cam_map(k) @ np.linalg.inv(closed.T_cam_map(parent))
    apply_adjustment(closed, adjustment)
    closed.check()
    again = closed.T_cam_map(k) @ np.linalg.inv(closed.T_cam_map(parent))
    np.testing.assert_allclose(again, step, atol=1e-12)
    in_camera = closed.T_cam_map(k)[:3] @ np.append(closed.arrays.pt_xyz[p], 1.0)
    np.testing.assert_allclose(in_camera, (0.1, 0.2, 3.0), atol=1e-12)


def test_what_has_gone_since_stays_gone(closed):
    adjustment = adjust_globally(closed)
    closed.cull_keyframe(12)
    lost = int(closed.points()[5])
    from slam._map_kernels import remove_point

    remove_point(closed.arrays, lost)
    apply_adjustment(closed, adjustment)
    closed.check()
    assert closed.arrays.kf_bad[12] and closed.arrays.pt_bad[lost]


def test_a_map_of_one_keyframe_has_nothing_to_adjust():
    r = ring(keyframes=30)
    for k in range(r.map.n_keyframes - 1, 0, -1):
        r.map.cull_keyframe(k)
    assert adjust_globally(r.map) is None
