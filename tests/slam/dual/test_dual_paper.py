"""The paper's Dual-SLAM: the whole buffer, one similarity from all points, an end at the first failure."""

import numpy as np
import pytest
from recovery_scenes import blind_scene
from slam_scenes import PointWorld, feed, rigid, toy, walk

from dslab.slam.dual.fusion.fuse import FusionConfig
from dslab.slam.dual.recovery.common_points import align_all, pairs_close_in_time
from dslab.slam.dual.recovery.interface import RecoveryConfig
from dslab.slam.factory import build_system
from dslab.slam.optimization.sim3 import sim3_decompose
from dslab.slam.toy_sequence import CAMERA

CONFIG = FusionConfig(confirmations=1, min_share=0.0, min_matches=20)
SCALE, MOVED = 0.5, rigid((1.0, -2.0, 0.5), (10, -20, 15))


@pytest.fixture(scope="module")
def maps():
    """An old map of frames 0 to 30, and a new one of 15 to 60, of half its scale and in another frame."""
    world, rng = PointWorld(seed=41), np.random.default_rng(42)
    seen = {i: world.see(i, walk(i), rng, noise_px=0.4, bits=8) for i in range(0, 61, 5)}
    old = world.map_of([seen[i] for i in range(0, 31, 5)], np.random.default_rng(43), noise=0.005)[0]
    new = world.map_of([seen[i] for i in range(60, 14, -5)], np.random.default_rng(44), 0.005, map_id=1)[0]
    new.transform(SCALE, MOVED[:3, :3], MOVED[:3, 3])
    return old, new


def test_all_points_of_keyframes_close_in_time_give_one_similarity(maps):
    old, new = maps
    pairs = pairs_close_in_time(old, new, list(range(new.n_keyframes)), CONFIG)
    apart = {old.frame_index(k) - new.frame_index(j) for k, j in pairs}
    assert apart == {-5, 0, 5} and len(pairs) == 4 * 3 - 1 + 1
    found, reason, count = align_all(old, new, pairs, np.random.default_rng(0), CONFIG)
    assert found is not None and reason == "" and count == found.inliers
    s, R, t = sim3_decompose(found.S_old_new)
    assert s == pytest.approx(1 / SCALE, rel=0.01) and found.scale == pytest.approx(s)
    for k in range(new.n_keyframes):
        centre = s * R @ np.linalg.inv(new.T_cam_map(k))[:3, 3] + t
        truth = np.linalg.inv(walk(new.frame_index(k)))[:3, 3]
        assert np.linalg.norm(centre - truth) < 0.1
    for points in (found.old_points, found.new_points):
        assert len(set(points.tolist())) == len(points), "each point once"
    one = align_all(old, new, [(found.old_keyframe, found.new_keyframe)], np.random.default_rng(0), CONFIG)[2]
    assert count > 1.2 * one, "more than one pair of keyframes gives"


def test_maps_that_share_too_little_have_no_similarity(maps):
    old, new = maps
    assert align_all(old, new, [], np.random.default_rng(0), CONFIG)[:2] == (None, "overlap")
    far = old.copy()
    far.arrays.pt_xyz[: far.n_points] = np.random.default_rng(1).normal(size=(far.n_points, 3)) * 5
    pairs = pairs_close_in_time(far, new, list(range(new.n_keyframes)), CONFIG)
    assert align_all(far, new, pairs, np.random.default_rng(0), CONFIG)[1] == "sim3"


@pytest.mark.slow
def test_the_whole_buffer_is_crossed_and_the_maps_compared_once():
    scene = blind_scene()
    usual = scene.run("orb")
    assert usual.success and usual.frames_covered < len(scene.task.backward)
    whole = scene.run("orb", RecoveryConfig(whole_buffer=True))
    assert whole.success and whole.frames_covered == len(scene.task.backward)
    assert whole.alignment.S_old_new == pytest.approx(usual.alignment.S_old_new)
    assert (whole.alignments_tried, len(whole.confirming)) == (usual.alignments_tried, len(usual.confirming))
    at_once = scene.run("orb", RecoveryConfig(whole_buffer=True, at_once=True, fusion=CONFIG))
    assert at_once.success and at_once.confirming == ()
    assert abs(scene.scale_error(at_once)) < 0.05
    assert at_once.inliers > whole.inliers


def test_the_threads_of_the_paper_end_at_the_first_frame_that_fails():
    """The blind frames of the breakage lie in the buffer: no gap is passed over."""
    for kind in ("paper_orb", "paper_sift"):
        result = blind_scene().run(kind)
        assert not result.success and result.stage == "propagation"
        assert result.frames_passed_over == 1


def test_the_systems_of_the_paper_start_maps_as_it_says():
    images, stamps_s, _ = toy(40, 0, 0.05)
    for kind, matcher in (("paper", "windowed"), ("paper+", "gms_alone")):
        system = build_system(kind, CAMERA)
        assert system.config.initialization.matcher == matcher and system.config.initial_features == 2.0
        feed(system, images, stamps_s)
        assert any(e.kind == "initialized" for e in system.events)
        assert not system.dual.relocalization and system.dual.place_merging is None
        system.finish()
