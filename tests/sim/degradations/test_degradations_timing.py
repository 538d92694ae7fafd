"""Kinds that act before rendering: dropped frames, wrong stamps, a stop, repeated textures."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dslab.scenarios.segments import FrameDrops, PureRotation, RepeatedTexture, TimeJitter
from dslab.scenarios.spec import Trajectory
from dslab.sim.degradations.base import FramePlan
from dslab.sim.degradations.registry import DEGRADATIONS
from dslab.sim.degradations.texture import px_per_m, with_repeated_texture
from dslab.sim.degradations.truth import truths_of
from dslab.sim.motion.walker import plan_walk
from dslab.sim.worlds.base import Route, Surface, WorldModel

TIMES = {"start_s": 2.0, "duration_s": 1.0}


@pytest.fixture(scope="module")
def plan() -> FramePlan:
    """Five seconds at 30 frames per second."""
    route = Route(np.array([[0.0, 0], [30, 0]]), 1.0, False)
    stamps_s = np.arange(150) / 30
    motion = plan_walk(route, Trajectory(), 5, 0)
    return FramePlan(
        stamps_s, motion, np.full(150, 0.004), np.ones(4), np.full((150, 4), 0.25, np.float32), seed=3
    )


def apply(plan: FramePlan, segment) -> FramePlan:
    return DEGRADATIONS[segment.kind].apply(plan, segment)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_share_of_frames_is_dropped_and_the_others_keep_their_numbers(plan, share):
    segment = FrameDrops(kind="frame_drops", share=share, **TIMES)
    dropped = apply(plan, segment)
    assert 150 - len(dropped.frame) == round(share * 29)
    np.testing.assert_array_equal(dropped.stamps_s, plan.stamps_s[dropped.frame])
    assert set(np.setdiff1d(np.arange(150), dropped.frame)) <= set(range(60, 89))
    assert dropped.view_share.shape == (len(dropped.frame), 4)
    (truth,), columns = truths_of((segment,), dropped, (), np.zeros(len(dropped.frame)))
    measure = columns[truth.measure]
    assert measure.sum() == round(share * 29)
    if share:
        assert 60 <= truth.first_frame <= truth.last_frame
        assert dropped.frame[truth.last_frame] <= 89
    else:
        assert truth.first_frame == -1


def test_a_larger_share_drops_the_same_frames_and_more(plan):
    few, many = (apply(plan, FrameDrops(kind="frame_drops", share=s, **TIMES)).frame for s in (0.2, 0.6))
    assert set(many) < set(few)


def test_drops_back_to_back_all_count(plan):
    one = FrameDrops(kind="frame_drops", share=0.5, **TIMES)
    two = one.model_copy(update={"start_s": 3.0})
    both = apply(apply(plan, one), two)
    assert 150 - len(both.frame) == 2 * round(0.5 * 29)
    measures = [DEGRADATIONS["frame_drops"].measure(both, s, np.empty(0)).sum() for s in (one, two)]
    assert measures == [14, 14]


def test_stamp_errors_have_the_sigma_and_keep_the_order(plan):
    small = apply(plan, TimeJitter(kind="time_jitter", sigma_s=0.002, start_s=0, duration_s=5))
    assert small.stamp_error_s.std() == pytest.approx(0.002, rel=0.2)
    wild = apply(plan, TimeJitter(kind="time_jitter", sigma_s=1.0, **TIMES))
    assert (np.diff(wild.stamps_s + wild.stamp_error_s) > 0).all()
    np.testing.assert_array_equal(np.flatnonzero(wild.stamp_error_s), np.arange(60, 90))
    np.testing.assert_array_equal(wild.stamps_s, plan.stamps_s)
    assert (plan.stamp_error_s == 0).all()


@pytest.mark.parametrize("axis", ["yaw", "pitch", "roll"])
def test_the_camera_turns_on_the_spot_and_continues_from_there(plan, axis):
    motion = apply(plan, PureRotation(kind="pure_rotation", angle_deg=70, axis=axis, **TIMES)).motion
    rest_s = np.linspace(2.15, 2.85, 301)
    T = motion.T_world_cam(rest_s)
    assert np.ptp(T[:, :3, 3], axis=0).max() < 1e-9
    turned = Rotation.from_matrix(T[0, :3, :3].T @ T[:, :3, :3]).magnitude()
    assert np.rad2deg(turned.max()) == pytest.approx(70, abs=0.01)
    assert turned[-1] == pytest.approx(0, abs=1e-9)
    later_s = np.array([3.0, 3.7, 4.4])
    cost_s = 0.85  # the stop, and half of braking and setting off
    np.testing.assert_allclose(
        motion.T_world_cam(later_s), plan.motion.T_world_cam(later_s - cost_s), atol=1e-9
    )
    np.testing.assert_allclose(motion.T_world_cam(1.9), plan.motion.T_world_cam(1.9))


def test_a_stop_from_the_first_frame_on_starts_at_rest(plan):
    motion = apply(plan, PureRotation(kind="pure_rotation", angle_deg=70, start_s=0, duration_s=1)).motion
    at_s = np.linspace(0, 0.85, 200)
    assert (motion.T_world_cam(at_s)[:, :3, 3] == plan.motion.T_world_cam(0.0)[:3, 3]).all()
    assert (motion.velocity_mps(at_s) == 0).all() and np.linalg.norm(motion.velocity_mps(0.99)) > 0
    later_s = np.array([1.0, 1.7, 2.4])
    cost_s = 0.925  # the stop, and half of setting off
    np.testing.assert_allclose(
        motion.T_world_cam(later_s), plan.motion.T_world_cam(later_s - cost_s), atol=1e-9
    )


@pytest.mark.parametrize("start_s", [0.0, 2.0])
def test_the_stopping_motion_has_its_own_derivatives(plan, start_s):
    segment = PureRotation(kind="pure_rotation", angle_deg=40, start_s=start_s, duration_s=1)
    motion = apply(plan, segment).motion
    stamps_s, step_s = start_s + np.linspace(-0.1, 1.1, 400), 1e-4
    before, after = (motion.T_world_cam(stamps_s + d) for d in (-step_s / 2, step_s / 2))
    np.testing.assert_allclose(motion.velocity_mps(stamps_s), (after - before)[:, :3, 3] / step_s, atol=1e-5)
    turn = Rotation.from_matrix(np.swapaxes(before[:, :3, :3], 1, 2) @ after[:, :3, :3]).as_rotvec()
    np.testing.assert_allclose(motion.rate_radps(stamps_s), turn / step_s, atol=1e-5)


def test_no_turn_is_no_stop(plan):
    assert apply(plan, PureRotation(kind="pure_rotation", angle_deg=0, **TIMES)) is plan


def wall(width_m: float, height_m: float, scale: float, seed: int) -> Surface:
    corners = np.array([[0, 0, 0], [width_m, 0, 0], [width_m, 0, height_m], [0, 0, height_m]], float)
    texture = np.random.default_rng(seed).integers(0, 255, (round(height_m * scale), round(width_m * scale)))
    uv = np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Surface(corners, triangles, uv, texture.astype(np.uint8), "wall")


def test_repeated_textures_show_one_patch_in_its_true_size():
    fine, coarse = wall(4, 3, 100, 0), wall(2, 3, 50, 1)
    assert px_per_m(coarse) == pytest.approx(50)
    world = WorldModel([fine, coarse], 118.0, np.ones(2))
    out = with_repeated_texture(world, np.array([0, 0]), np.array([0.0, 0.4]))
    assert out.surfaces[0] is fine
    texture = out.surfaces[1].texture
    assert texture.shape == coarse.texture.shape
    np.testing.assert_array_equal(texture[:, 20:], texture[:, :-20])
    np.testing.assert_array_equal(texture[20:], texture[:-20])
    assert texture[:20, :20].std() > 10
    assert with_repeated_texture(world, np.array([0, 1]), np.zeros(2)) is world


def test_the_most_seen_surfaces_repeat_the_patch_until_they_fill_the_share(plan):
    seen = np.zeros((150, 4), np.float32)
    seen[60:90] = [0.1, 0.5, 0.3, 0]
    seen[10, 3] = 0.9
    for share, expected in ((0, []), (0.5, [1]), (0.8, [1, 2]), (1, [0, 1, 2])):
        segment = RepeatedTexture(kind="repeated_texture", share=share, period_m=0.3, **TIMES)
        repeated = apply(replace(plan, view_share=seen, moment_s=np.empty(0)), segment)
        np.testing.assert_array_equal(np.flatnonzero(repeated.period_m), expected)
        assert (repeated.texture_of[expected] == 1).all()
        measure = DEGRADATIONS["repeated_texture"].measure(repeated, segment, np.empty(0))
        assert measure[70] == pytest.approx(seen[70][expected].sum())
