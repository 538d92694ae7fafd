"""The walking motion: within its limits, in the free space, and with rates that fit its poses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from world_views import distance_to_route

from dslab.scenarios.spec import Trajectory
from dslab.sim.motion.path import smooth_path
from dslab.sim.motion.spline import PoseSpline
from dslab.sim.motion.walker import PAD_S, plan_walk
from dslab.sim.worlds.base import Route

RING = Route(np.array([[-4.0, -2.5], [4, -2.5], [4, 2.5], [-4, 2.5]]), 0.8, True)
CORNERS = Route(np.array([[0.0, 0], [14, 0], [14, 12], [28, 12]]), 0.7, False)
SHORT = Route(np.array([[0.0, 0], [5, 0]]), 0.5, False)
TIGHT = Route(np.array([[0.0, 0], [3, 0], [3, 2], [6, 2], [6, 6]]), 0.15, False)
ROUTES = {"ring": RING, "corners": CORNERS, "short": SHORT, "tight": TIGHT}


@pytest.mark.parametrize("route", ROUTES.values(), ids=ROUTES)
@pytest.mark.parametrize("speed_mps", [0.5, 3.0])
def test_speed_and_rate_stay_within_the_limits_and_the_path_in_the_free_space(route, speed_mps):
    limits = Trajectory(max_speed_mps=speed_mps, max_rate_degps=35, gaze_deg=30)
    motion = plan_walk(route, limits, 12, 0)
    stamps_s = np.arange(0, 12, 0.003)
    assert np.linalg.norm(motion.velocity_mps(stamps_s), axis=1).max() <= speed_mps
    assert np.rad2deg(np.linalg.norm(motion.rate_radps(stamps_s), axis=1)).max() <= 35
    centres = motion.T_world_cam(stamps_s)[:, :3, 3]
    assert distance_to_route(centres[:, :2], route).max() <= route.clearance_m


def test_velocity_and_rate_are_the_derivatives_of_the_pose():
    motion = plan_walk(CORNERS, Trajectory(gaze_deg=40), 20, 1)
    step_s = 1e-4
    stamps_s = np.linspace(-0.5, 20.5, 400)
    before, after = motion.T_world_cam(stamps_s - step_s / 2), motion.T_world_cam(stamps_s + step_s / 2)
    velocity = (after - before)[:, :3, 3] / step_s
    turned = np.swapaxes(before[:, :3, :3], 1, 2) @ after[:, :3, :3]
    rate = Rotation.from_matrix(turned).as_rotvec() / step_s
    np.testing.assert_allclose(motion.velocity_mps(stamps_s), velocity, atol=1e-6)
    np.testing.assert_allclose(motion.rate_radps(stamps_s), rate, atol=1e-6)


def test_a_stretched_motion_takes_the_same_path_more_slowly():
    knots_s = np.arange(0, 4, 0.25)
    position = np.column_stack([knots_s, np.sin(knots_s), np.ones_like(knots_s)])
    turns = np.column_stack([0.3 * knots_s, 0.1 * np.cos(knots_s), 0 * knots_s])
    plain, slow = PoseSpline(knots_s, position, turns), PoseSpline(knots_s, position, turns, 2.0)
    np.testing.assert_allclose(slow.T_world_cam(3.0), plain.T_world_cam(1.5), atol=1e-12)
    np.testing.assert_allclose(slow.velocity_mps(3.0), plain.velocity_mps(1.5) / 2, atol=1e-12)
    np.testing.assert_allclose(slow.rate_radps(3.0), plain.rate_radps(1.5) / 2, atol=1e-12)


def test_the_camera_is_upright_and_looks_where_the_gaze_says():
    straight = Route(np.array([[0.0, 0], [100, 0]]), 0.5, False)
    stamps_s = np.linspace(0, 10, 50)
    for gaze_deg, forward in ((0, (1, 0, 0)), (90, (0, 1, 0)), (180, (-1, 0, 0)), (-90, (0, -1, 0))):
        motion = plan_walk(straight, Trajectory(gaze_deg=gaze_deg), 10, 0)
        R = motion.T_world_cam(stamps_s)[:, :3, :3]
        np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-12)
        assert (R[:, :, 2] @ forward > np.cos(np.deg2rad(6))).all()
        assert (R[:, 2, 1] < -0.99).all()  # the camera's y points down
        assert (motion.velocity_mps(stamps_s)[:, 0] > 0.3).all()


def test_seeds_vary_the_motion_and_repeat_it():
    trajectory = Trajectory()
    one, same, other = (plan_walk(RING, trajectory, 5, seed).T_world_cam(2.0) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 0.05


def test_an_open_route_that_is_too_short_is_walked_slowly_to_its_end():
    motion = plan_walk(SHORT, Trajectory(max_speed_mps=2), 20, 0)
    ends = motion.T_world_cam(np.array([-PAD_S, 20 + PAD_S]))[:, 0, 3]
    assert -0.1 < ends[0] < 0.6
    assert 4.4 < ends[1] < 5.1


def test_a_closed_route_is_walked_round_and_round():
    motion = plan_walk(RING, Trajectory(max_speed_mps=2, max_rate_degps=90), 40, 0)
    stamps_s = np.arange(0, 40, 0.01)
    walked_m = np.linalg.norm(motion.velocity_mps(stamps_s), axis=1).mean() * 40
    assert walked_m > 2 * 24
    centres = motion.T_world_cam(stamps_s)[:, :2, 3]
    assert np.ptp(centres[:, 0]) < 8 + 2 * 0.8


@pytest.mark.parametrize("route", ROUTES.values(), ids=ROUTES)
def test_the_path_turns_corners_without_a_kink(route):
    path = smooth_path(route, np.random.default_rng(0))
    steps = np.diff(path, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    assert lengths.max() < 0.08
    turn = np.abs(
        (steps[1:, 0] * steps[:-1, 1] - steps[1:, 1] * steps[:-1, 0]) / (lengths[1:] * lengths[:-1])
    )
    assert np.rad2deg(np.arcsin(turn.max())) < 15
