"""Frame poses follow their keyframes."""

import numpy as np
import pytest
from slam_scenes import make_frame, random_map, rigid

from dslab.slam.core.frame import Frame
from dslab.slam.map.trajectory import FramePoses, keyframe_trajectory

RNG = np.random.default_rng(0)


def tracked(index, map_, keyframe, offset):
    """A frame at a known offset from a keyframe."""
    frame = Frame(make_frame(index, RNG).features)
    frame.reference_keyframe = keyframe
    frame.T_cam_reference = offset
    frame.T_cam_map = offset @ map_.T_cam_map(keyframe)
    return frame


@pytest.fixture
def m():
    return random_map(np.random.default_rng(1))


def record(m, count=8, map_id=0):
    poses = FramePoses()
    offsets = [rigid((0.01 * i, 0, 0.02), (0, i, 0)) for i in range(count)]
    for i, offset in enumerate(offsets):
        poses.add(map_id, tracked(i, m, i % 5, offset))
    return poses, offsets


def test_a_frame_has_its_tracked_pose(m):
    poses, offsets = record(m)
    path = poses.trajectory(0, m)
    assert path.map_id == 0 and path.frames.tolist() == list(range(8))
    np.testing.assert_allclose(path.stamps_s, np.arange(8) / 30)
    for i, offset in enumerate(offsets):
        np.testing.assert_allclose(np.linalg.inv(path.T_map_cam[i]), offset @ m.T_cam_map(i % 5), atol=1e-12)


def test_a_frame_follows_its_keyframe_when_that_is_adjusted(m):
    poses, offsets = record(m)
    before = poses.trajectory(0, m).T_map_cam
    m.arrays.kf_T_cam_map[2] = rigid((0.3, 0.1, -0.2), (4, 5, 6)) @ m.T_cam_map(2)
    after = poses.trajectory(0, m).T_map_cam
    moved = [i for i in range(8) if not np.array_equal(before[i], after[i])]
    assert moved == [2, 7]
    np.testing.assert_allclose(np.linalg.inv(after[7]), offsets[7] @ m.T_cam_map(2), atol=1e-12)


def test_a_frame_of_a_culled_keyframe_follows_the_parent(m):
    poses, _ = record(m)
    before = poses.trajectory(0, m).T_map_cam
    m.cull_keyframe(2)
    np.testing.assert_allclose(poses.trajectory(0, m).T_map_cam, before, atol=1e-12)
    shift = rigid((0.5, 0, 0))
    m.arrays.kf_T_cam_map[1] = m.arrays.kf_T_cam_map[1] @ np.linalg.inv(shift)
    np.testing.assert_allclose(poses.trajectory(0, m).T_map_cam[2], shift @ before[2], atol=1e-12)


def test_the_trajectory_moves_with_the_map(m):
    poses, _ = record(m, count=5)
    Q = rigid(rotvec_deg=(10, 20, 30))[:3, :3]
    before = poses.trajectory(0, m).T_map_cam
    m.transform(1.0, Q, np.array([1.0, 2.0, 3.0]))
    after = poses.trajectory(0, m).T_map_cam
    np.testing.assert_allclose(after[:, :3, :3], Q @ before[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(after[:, :3, 3], before[:, :3, 3] @ Q.T + (1, 2, 3), atol=1e-12)


def test_the_last_record_of_a_frame_is_used(m):
    poses, _ = record(m)
    better = rigid((0.7, 0, 0))
    poses.add(0, tracked(3, m, 1, better))
    assert poses.count(0) == 8
    np.testing.assert_allclose(
        np.linalg.inv(poses.trajectory(0, m).T_map_cam[3]), better @ m.T_cam_map(1), atol=1e-12
    )


def test_later_changes_of_the_frame_do_not_reach_the_record(m):
    poses = FramePoses()
    frame = tracked(0, m, 1, rigid((0.1, 0, 0)))
    poses.add(0, frame)
    before = poses.trajectory(0, m).T_map_cam
    frame.T_cam_reference[:3, 3] = 9.0
    np.testing.assert_array_equal(poses.trajectory(0, m).T_map_cam, before)


def test_a_frame_without_a_pose_is_refused(m):
    poses = FramePoses()
    with pytest.raises(ValueError, match="pose"):
        poses.add(0, make_frame(0, RNG))


def test_a_dropped_map_has_no_frames(m):
    poses, _ = record(m)
    poses.drop(0)
    assert poses.count(0) == 0
    assert len(poses.trajectory(0, m).frames) == 0
    assert poses.trajectory(0, m).T_map_cam.shape == (0, 4, 4)


def test_frames_of_an_absorbed_map_follow_its_keyframes(m):
    """Their poses follow its motion and scale; a frame of both maps occurs once."""
    other = random_map(np.random.default_rng(2), map_id=1)
    poses, _ = record(m)
    for i in range(5, 12):
        poses.add(1, tracked(i, other, i % 6, rigid((0.03 * i, 0, 0.02), (0, i, 0))))
    mine = poses.trajectory(0, m).T_map_cam
    theirs = poses.trajectory(1, other).T_map_cam
    Q, t, scale = rigid(rotvec_deg=(5, 10, -20))[:3, :3], np.array([1.0, 2.0, 3.0]), 2.5
    other.transform(scale, Q, t)
    keyframes, _ = m.absorb(other)
    poses.join(0, 1, keyframes, scale)
    path = poses.trajectory(0, m)
    assert path.frames.tolist() == list(range(12))
    assert poses.count(1) == 0
    np.testing.assert_allclose(path.T_map_cam[:8], mine, atol=1e-12)
    np.testing.assert_allclose(path.T_map_cam[8:, :3, 3], scale * theirs[3:, :3, 3] @ Q.T + t, atol=1e-9)
    np.testing.assert_allclose(path.T_map_cam[8:, :3, :3], Q @ theirs[3:, :3, :3], atol=1e-9)


def test_keyframes_are_listed_in_order_of_time_without_the_culled(m):
    """A recovery inserts keyframes backward in time; a frame of a fusion is a keyframe twice."""
    late = m.add_keyframe(make_frame(9, RNG), 5)
    again = m.add_keyframe(make_frame(1, RNG, T=rigid((0, 0, 1))), 0)
    m.cull_keyframe(4)
    path = keyframe_trajectory(m)
    assert path.frames.tolist() == [0, 1, 2, 3, 5, 9]
    np.testing.assert_allclose(path.stamps_s, path.frames / 30)
    rows = [np.linalg.inv(m.T_cam_map(k)) for k in (0, again, 2, 3, 5, late)]
    np.testing.assert_allclose(path.T_map_cam, rows, atol=1e-12)
