"""An adjustment of an earlier state of the map, applied to the present map."""

import numpy as np
import pytest
from loop_scenes import ring
from slam_scenes import make_frame

from dslab.slam.loop_closing.correction import correct_loop
from dslab.slam.loop_closing.global_adjustment import adjust_globally
from dslab.slam.map.adjustment import apply_adjustment
from dslab.slam.map.compaction import drop_culled_keypoints
from dslab.slam.map.invariants import check_map
from dslab.slam.mapping.local_mapping import LocalMappingConfig


@pytest.fixture
def closed():
    r = ring(keyframes=30)
    correct_loop(r.map, r.loop, r.loop_points, LocalMappingConfig())
    return r.map


def test_the_map_is_unchanged_until_the_adjustment_is_applied(closed):
    before = [array.copy() for array in closed.arrays]
    adjustment = adjust_globally(closed)
    for old, new in zip(before, closed.arrays, strict=True):
        np.testing.assert_array_equal(old, new)
    apply_adjustment(closed, adjustment)
    check_map(closed)
    np.testing.assert_array_equal(closed.arrays.kf_T_cam_map[adjustment.keyframes], adjustment.T_cam_map)
    still = ~closed.arrays.pt_bad[adjustment.points]
    np.testing.assert_array_equal(closed.arrays.pt_xyz[adjustment.points[still]], adjustment.xyz[still])
    keyframe, index = adjustment.outliers.T
    rows = closed.arrays.kf_start[keyframe] + index
    assert not (closed.arrays.kp_point[rows] == adjustment.of_points).any()


def test_newer_keyframes_and_points_follow_their_parents(closed):
    adjustment = adjust_globally(closed)
    parent = closed.n_keyframes - 1
    frame = make_frame(999, np.random.default_rng(0), T=np.linalg.inv(np.diag([1.0, 1, 1, 1])))
    frame.T_cam_map = closed.T_cam_map(parent) @ frame.T_cam_map
    k = closed.add_keyframe(frame, parent)
    row = closed.keypoints(k).start
    p = closed.create_point(np.linalg.inv(frame.T_cam_map)[:3] @ (0.1, 0.2, 3.0, 1.0), row)
    step = closed.T_cam_map(k) @ np.linalg.inv(closed.T_cam_map(parent))
    apply_adjustment(closed, adjustment)
    check_map(closed)
    again = closed.T_cam_map(k) @ np.linalg.inv(closed.T_cam_map(parent))
    np.testing.assert_allclose(again, step, atol=1e-12)
    in_camera = closed.T_cam_map(k)[:3] @ np.append(closed.arrays.pt_xyz[p], 1.0)
    np.testing.assert_allclose(in_camera, (0.1, 0.2, 3.0), atol=1e-12)


def test_what_was_culled_since_stays_culled(closed):
    adjustment = adjust_globally(closed)
    closed.cull_keyframe(12)
    lost = int(closed.points()[5])
    from dslab.slam.map._map_kernels import remove_point

    remove_point(closed.arrays, lost)
    apply_adjustment(closed, adjustment)
    check_map(closed)
    assert closed.arrays.kf_bad[12] and closed.arrays.pt_bad[lost]


def test_removed_keypoints_of_culled_keyframes_do_not_matter(closed):
    """Outliers are given by keyframe and keypoint, which stay valid when rows move."""
    a = closed.arrays
    for k in (5, 20):
        a.kp_xy[closed.keypoints(k).start + np.flatnonzero(closed.observed_points(k) >= 0)[:3]] += 100.0
    adjustment = adjust_globally(closed)
    assert {5, 20} <= set(adjustment.outliers[:, 0].tolist())
    closed.cull_keyframe(5)
    packed = closed.copy()
    drop_culled_keypoints(packed.arrays, packed.n_keyframes, packed.n_points)
    for m in (closed, packed):
        apply_adjustment(m, adjustment)
        check_map(m)
    np.testing.assert_array_equal(packed.points(), closed.points())
    np.testing.assert_array_equal(packed.arrays.pt_xyz, closed.arrays.pt_xyz)
    np.testing.assert_array_equal(packed.observed_points(20), closed.observed_points(20))
    assert (closed.observed_points(20) >= 0).any()


def test_a_map_of_one_keyframe_has_nothing_to_adjust():
    r = ring(keyframes=30)
    for k in range(r.map.n_keyframes - 1, 0, -1):
        r.map.cull_keyframe(k)
    with pytest.raises(ValueError, match="two cameras"):
        adjust_globally(r.map)
