"""Keypoints of culled keyframes are removed without other effects."""

import numpy as np
import pytest
from slam_scenes import make_frame, random_map

from dslab.slam.map.compaction import culled_keypoints, drop_culled_keypoints
from dslab.slam.map.invariants import check_map

KEYFRAMES, CULLED = 12, (2, 3, 7, 11)


@pytest.fixture
def whole():
    m = random_map(np.random.default_rng(3), keyframes=KEYFRAMES, points=200)
    for k in CULLED:
        m.cull_keyframe(k)
    return m


def observers(m, point):
    """(keyframe, index of its keypoint) of every observer, in the order of the list."""
    a, found, e = m.arrays, [], int(m.arrays.pt_head[point])
    while e >= 0:
        k = int(a.kp_keyframe[e])
        found.append((k, e - int(a.kf_start[k])))
        e = int(a.kp_next[e])
    return found


def test_the_rest_of_the_map_is_unchanged(whole):
    packed = whole.copy()
    drop_culled_keypoints(packed.arrays, packed.n_keyframes, packed.n_points)
    check_map(packed)
    for k in whole.keyframes():
        there, here = whole.keypoints(k), packed.keypoints(k)
        assert here.stop - here.start == there.stop - there.start > 0
        for name in ("kp_xy", "kp_octave", "kp_angle", "kp_descriptor", "kp_keyframe", "kp_point"):
            np.testing.assert_array_equal(
                getattr(packed.arrays, name)[here], getattr(whole.arrays, name)[there]
            )
    assert [observers(packed, p) for p in whole.points()] == [observers(whole, p) for p in whole.points()]
    np.testing.assert_array_equal(packed.arrays.covisibility, whole.arrays.covisibility)


def test_culled_keyframes_have_no_keypoints_left(whole):
    gone = culled_keypoints(whole.arrays, whole.n_keyframes)
    used = int(whole.arrays.kf_start[whole.n_keyframes])
    assert gone == sum(whole.keypoints(k).stop - whole.keypoints(k).start for k in CULLED) > 0
    drop_culled_keypoints(whole.arrays, whole.n_keyframes, whole.n_points)
    assert [len(whole.observed_points(k)) for k in CULLED] == [0] * len(CULLED)
    assert int(whole.arrays.kf_start[whole.n_keyframes]) == used - gone
    assert culled_keypoints(whole.arrays, whole.n_keyframes) == 0
    assert (whole.arrays.kp_point[used - gone :] == -1).all()
    for _ in range(2):  # once more changes nothing
        before = [array.copy() for array in whole.arrays]
        drop_culled_keypoints(whole.arrays, whole.n_keyframes, whole.n_points)
        for old, new in zip(before, whole.arrays, strict=True):
            np.testing.assert_array_equal(old, new)


def test_a_map_that_culls_reuses_its_capacity(whole):
    """Two thousand keyframes of 400 keypoints are made, nearly all are culled."""
    rng, sizes = np.random.default_rng(0), []
    frame = make_frame(100, rng, n=400)
    for _ in range(2000):
        k = whole.add_keyframe(frame, 0)
        assert len(whole.observed_points(k)) == 400
        np.testing.assert_array_equal(whole.arrays.kp_xy[whole.keypoints(k)], frame.features.xy)
        whole.cull_keyframe(k)
        sizes.append(len(whole.arrays.kp_octave))
    assert set(sizes) == {16_384}
    check_map(whole)


def test_a_map_that_does_not_cull_grows():
    m = random_map(np.random.default_rng(3), keyframes=3, points=20)
    frame = make_frame(100, np.random.default_rng(0), n=400)
    for _ in range(60):
        m.add_keyframe(frame, 0)
    assert len(m.arrays.kp_octave) >= 60 * 400
    check_map(m)
