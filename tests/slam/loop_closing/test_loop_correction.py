"""A drifted ring is closed: drift is distributed, duplicates are fused, the map stays valid."""

import numpy as np
import pytest
from loop_scenes import ring

from dslab.slam.loop_closing.correction import correct_loop
from dslab.slam.loop_closing.essential_graph import essential_edges, optimize_essential_graph
from dslab.slam.loop_closing.global_adjustment import adjust_globally
from dslab.slam.map.adjustment import apply_adjustment
from dslab.slam.map.compaction import drop_culled_keypoints
from dslab.slam.map.invariants import check_map
from dslab.slam.mapping.local_mapping import LocalMappingConfig
from dslab.slam.optimization.sim3 import horn_sim3


def error_m(r):
    estimate, truth = r.centres(), r.true_centres()
    s, R, t = horn_sim3(truth, estimate)
    return float(np.sqrt(((s * estimate @ R.T + t - truth) ** 2).sum(1).mean()))


@pytest.fixture
def drifted():
    r = ring()
    check_map(r.map)
    return r


def test_the_drift_is_less_than_a_third_and_less_again_after_adjustment(drifted):
    before = error_m(drifted)
    correct_loop(drifted.map, drifted.loop, drifted.loop_points, LocalMappingConfig())
    check_map(drifted.map)
    after = error_m(drifted)
    assert before > 0.3 and after < before / 3
    apply_adjustment(drifted.map, adjust_globally(drifted.map, 20))
    check_map(drifted.map)
    assert error_m(drifted) < after / 3


def test_removed_keypoints_do_not_change_the_correction(drifted):
    m = drifted.map
    m.cull_keyframe(30)
    packed = m.copy()
    drop_culled_keypoints(packed.arrays, packed.n_keyframes, packed.n_points)
    factors = [
        correct_loop(each, drifted.loop, drifted.loop_points, LocalMappingConfig()) for each in (m, packed)
    ]
    np.testing.assert_array_equal(*factors)
    np.testing.assert_array_equal(packed.arrays.kf_T_cam_map, m.arrays.kf_T_cam_map)
    np.testing.assert_array_equal(packed.arrays.pt_xyz, m.arrays.pt_xyz)
    check_map(packed)


def test_both_sides_share_their_points_after_the_correction(drifted):
    m, k, q = drifted.map, drifted.loop.keyframe, drifted.loop.loop_keyframe
    points = len(m.points())
    assert m.arrays.covisibility[k, q] == 0
    correct_loop(m, drifted.loop, drifted.loop_points, LocalMappingConfig())
    assert m.arrays.covisibility[k, q] >= len(drifted.loop.points)
    assert len(m.points()) <= points - len(drifted.loop.points)
    assert (k, q) in m.loop_edges
    assert [k, q] in essential_edges(m).tolist()
    # Points of neighbouring keyframes were fused too.
    assert m.arrays.covisibility[k - 1, q - 1] > 50


def test_lengths_follow_the_correction(drifted):
    """The factor corrects the excess scale around a keyframe."""
    m = drifted.map
    m.cull_keyframe(30)
    parent = m.parent(30)
    relative = m.T_cam_map(30) @ np.linalg.inv(m.T_cam_map(parent))
    depth = np.median(_depths(m, drifted.loop.keyframe))
    factor = correct_loop(m, drifted.loop, drifted.loop_points, LocalMappingConfig())
    k = drifted.loop.keyframe
    assert factor[drifted.loop.loop_keyframe] == pytest.approx(1.0, abs=1e-12)
    assert factor[k] < 0.8
    assert np.median(_depths(m, k)) == pytest.approx(factor[k] * depth, rel=0.02)
    assert factor[30] == factor[parent]
    again = m.T_cam_map(30) @ np.linalg.inv(m.T_cam_map(parent))
    np.testing.assert_allclose(again[:3, :3], relative[:3, :3], atol=1e-12)
    np.testing.assert_allclose(again[:3, 3], factor[30] * relative[:3, 3], atol=1e-12)


def _depths(m, k):
    T = m.T_cam_map(k)
    points = m.observed_points(k)
    return (m.arrays.pt_xyz[points[points >= 0]] @ T[:3, :3].T + T[:3, 3])[:, 2]


def test_the_essential_graph_has_tree_and_strong_edges_once(drifted):
    m = drifted.map
    edges = essential_edges(m)
    assert len({frozenset(e) for e in edges.tolist()}) == len(edges)
    pairs = {tuple(e) for e in edges.tolist()}
    assert {(k, k - 1) for k in range(1, m.n_keyframes)} <= pairs
    strong = {
        tuple(p) for p in np.argwhere(np.tril(m.arrays.covisibility[: m.n_keyframes], -1) >= 100).tolist()
    }
    assert strong <= pairs
    assert pairs - strong <= {(k, k - 1) for k in range(1, m.n_keyframes)}
    m.cull_keyframe(10)
    assert not (essential_edges(m) == 10).any()
    assert [11, 9] in essential_edges(m).tolist()


def test_without_a_new_edge_nothing_moves(drifted):
    m = drifted.map
    T = m.arrays.kf_T_cam_map[: m.n_keyframes].copy()
    S = optimize_essential_graph(m, T, np.empty((0, 2)), 0)
    np.testing.assert_allclose(S, T, atol=1e-9)
