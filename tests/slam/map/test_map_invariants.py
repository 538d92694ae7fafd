"""Every broken invariant of a map is reported by name."""

import numpy as np
import pytest
from slam_scenes import random_map

from dslab.slam.map.invariants import InvariantError, check_map


@pytest.fixture
def sound():
    """A valid map with a culled keyframe and a replaced point."""
    from dslab.slam.map import _map_kernels as kernels

    m = random_map(np.random.default_rng(11))
    m.cull_keyframe(3)
    kernels.replace_point(m.arrays, *m.points()[:2].astype(np.int32), m.view)
    check_map(m)
    return m


def good(m):
    return int(m.points()[-1])


def observation(m):
    """A keypoint that observes a point."""
    return int(m.arrays.pt_head[good(m)])


def pose_not_finite(m):
    m.arrays.kf_T_cam_map[1, 0, 3] = np.nan


def pose_scaled(m):
    m.arrays.kf_T_cam_map[1, :3, :3] *= 1.01


def pose_mirrored(m):
    m.arrays.kf_T_cam_map[1, :3, :3] *= -1


def pose_projective(m):
    m.arrays.kf_T_cam_map[1, 3, 0] = 1


def keyframe_beyond_the_last(m):
    m.arrays.kf_bad[m.n_keyframes] = False


def keyframe_without_features(m):
    m._features.pop()


def slice_too_long(m):
    m.arrays.kf_start[2] += 1


def keypoint_of_another(m):
    m.arrays.kp_keyframe[0] = 1


def features_changed(m):
    m.arrays.kp_descriptor[0, 0] ^= 1


def cells_changed(m):
    m.arrays.kf_cells[0, -1] += 1


def loop_edge_to_nowhere(m):
    m.loop_edges.append((0, m.n_keyframes))


def point_beyond_the_last(m):
    m.arrays.pt_bad[m.n_points] = False


def point_not_finite(m):
    m.arrays.pt_xyz[good(m)] = np.inf


def direction_not_finite(m):
    m.arrays.pt_normal[good(m)] = np.nan


def distance_zero(m):
    m.arrays.pt_max_distance[good(m)] = 0


def first_keyframe_unknown(m):
    m.arrays.pt_first_keyframe[good(m)] = m.n_keyframes


def replaced_but_there(m):
    m.arrays.pt_replaced[good(m)] = int(m.points()[0])


def heir_does_not_exist(m):
    m.arrays.pt_replaced[np.flatnonzero(m.arrays.pt_bad[: m.n_points])[0]] = m.n_points


def heirs_in_a_circle(m):
    p = np.flatnonzero(m.arrays.pt_bad[: m.n_points])[0]
    m.arrays.pt_replaced[p] = p


def observes_nothing_known(m):
    m.arrays.kp_point[observation(m)] = m.n_points


def observes_a_dropped_point(m):
    m.arrays.pt_bad[good(m)] = True


def forgets_an_observation(m):
    m.arrays.kp_point[observation(m)] = -1


def count_wrong(m):
    m.arrays.pt_observations[good(m)] += 1


def unobserved(m):
    p = m.reserve_points(1)
    m.arrays.pt_bad[p], m.arrays.pt_max_distance[p] = False, 1.0
    m.arrays.pt_xyz[p] = m.arrays.pt_normal[p] = 1.0
    m.arrays.pt_reference[p] = m.arrays.pt_first_keyframe[p] = m.arrays.pt_observations[p] = 0


def culled_observes(m):
    k = int(m.arrays.kp_keyframe[observation(m)])
    m.arrays.kf_bad[k] = True
    m._features[k] = m._features[k].emptied()


def observed_twice(m):
    e = observation(m)
    k = int(m.arrays.kp_keyframe[e])
    free = m.keypoints(k).start + np.flatnonzero(m.observed_points(k) < 0)[0]
    p = m.arrays.kp_point[e]
    m.arrays.kp_point[free], m.arrays.kp_next[free], m.arrays.pt_head[p] = p, m.arrays.pt_head[p], free
    m.arrays.pt_observations[p] += 1


def reference_does_not_observe(m):
    m.arrays.pt_reference[good(m)] = 3


def list_into_another(m):
    m.arrays.kp_next[observation(m)] = m.arrays.pt_head[int(m.points()[0])]


def list_cut_short(m):
    m.arrays.kp_next[observation(m)] = -1


def list_in_a_circle(m):
    m.arrays.kp_next[observation(m)] = observation(m)


def covisibility_wrong(m):
    m.arrays.covisibility[0, 1] += 1
    m.arrays.covisibility[1, 0] += 1


def covisible_with_itself(m):
    m.arrays.covisibility[0, 0] = 1


def culled_without_pose(m):
    m._T_cam_parent.clear()


def culled_pose_not_finite(m):
    m._T_cam_parent[3][0, 3] = np.nan


def parent_unknown(m):
    m.set_parent(5, m.n_keyframes)


def root_culled(m):
    m.set_parent(3, -1)


def under_a_culled_one(m):
    m.set_parent(5, 3)


def tree_in_a_circle(m):
    m.set_parent(4, 5)
    m.set_parent(5, 4)


BROKEN = {
    pose_not_finite: "a keyframe pose is not finite",
    pose_scaled: "a keyframe pose is no rotation",
    pose_mirrored: "a keyframe pose is no rotation",
    pose_projective: "another last row",
    keyframe_beyond_the_last: "a keyframe beyond the last",
    keyframe_without_features: "keyframes without features",
    slice_too_long: "keypoint slices and features disagree",
    keypoint_of_another: "a keypoint of another keyframe's slice",
    features_changed: "features have changed",
    cells_changed: "features have changed",
    loop_edge_to_nowhere: "a loop edge",
    point_beyond_the_last: "a map point beyond the last",
    point_not_finite: "a map point is not finite",
    direction_not_finite: "a viewing direction is not finite",
    distance_zero: "largest distance is no length",
    first_keyframe_unknown: "pt_first_keyframe of a keyframe that does not exist",
    replaced_but_there: "a replaced point is not dropped",
    heir_does_not_exist: "replaced by one that does not exist",
    heirs_in_a_circle: "replace one another in a circle",
    observes_nothing_known: "an observation of a point that does not exist",
    observes_a_dropped_point: "an observation of a dropped point",
    forgets_an_observation: "observation counts disagree",
    count_wrong: "observation counts disagree",
    unobserved: "a point that no keyframe observes",
    culled_observes: "a culled keyframe observes",
    observed_twice: "observes a point twice",
    reference_does_not_observe: "reference keyframe does not observe it",
    list_into_another: "runs into another point",
    list_cut_short: "an observer list is incomplete",
    list_in_a_circle: "an observer list is incomplete",
    covisibility_wrong: "covisibility disagrees",
    covisible_with_itself: "covisibility disagrees",
    culled_without_pose: "culled keyframes and poses kept for them disagree",
    culled_pose_not_finite: "a culled keyframe's pose is not finite",
    parent_unknown: "a parent that does not exist",
    root_culled: "a root keyframe is culled",
    under_a_culled_one: "has a culled parent",
    tree_in_a_circle: "the spanning tree has a cycle",
}


@pytest.mark.parametrize("corrupt", BROKEN, ids=lambda corrupt: corrupt.__name__)
def test_a_broken_invariant_is_named(sound, corrupt):
    corrupt(sound)
    with pytest.raises(InvariantError, match=BROKEN[corrupt]):
        check_map(sound)


def test_checking_changes_nothing(sound):
    before = sound.copy()
    check_map(sound)
    for mine, theirs in zip(sound.arrays, before.arrays, strict=True):
        assert mine.tobytes() == theirs.tobytes()


def test_a_map_without_points_and_one_without_keyframes_are_valid():
    from dslab.slam.map import _map_kernels as kernels
    from dslab.slam.map.map import Map

    m = random_map(np.random.default_rng(12))
    kernels.remove_points(m.arrays, m.points())
    check_map(m)
    check_map(Map(0, m.view))
