"""Every kind of motion: its limits, its free space, its derivatives, and its own character."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from world_views import distance_to_route

from dslab.scenarios.motions import KINDS, Trajectory
from dslab.scenarios.worlds import CityWorld
from dslab.sim.motion import plan_motion
from dslab.sim.motion.planning import PAD_S, limited_pace
from dslab.sim.motion.walker import plan_walk
from dslab.sim.worlds import layout
from dslab.sim.worlds.base import Route

LOOP = layout(CityWorld(length_m=400, loop=True), 1)
STREETS = layout(CityWorld(length_m=400, turns=2), 1)
CORNERS = Route(np.array([[0.0, 0], [14, 0], [14, 12], [28, 12]]), 0.7, False)
CASES = [("walk", CORNERS), ("handheld", CORNERS), ("car", LOOP), ("drone", STREETS)]
SEED = 3


@pytest.mark.parametrize(("kind", "route"), CASES, ids=[kind for kind, _ in CASES])
class TestEveryMotion:
    def test_speed_and_rate_stay_within_the_limits_and_the_path_in_the_free_space(self, kind, route):
        limits = Trajectory(kind=kind)
        motion = plan_motion(route, limits, 15, SEED)
        stamps_s = np.arange(0, 15, 0.004)
        assert np.linalg.norm(motion.velocity_mps(stamps_s), axis=1).max() <= limits.max_speed_mps
        assert np.rad2deg(np.linalg.norm(motion.rate_radps(stamps_s), axis=1)).max() <= limits.max_rate_degps
        centres = motion.T_world_cam(stamps_s[::25])[:, :3, 3]
        assert distance_to_route(centres[:, :2], route).max() <= route.clearance_m
        assert abs(np.median(centres[:, 2]) - limits.eye_height_m) < 0.1

    def test_velocity_and_rate_are_the_derivatives_of_the_pose(self, kind, route):
        motion = plan_motion(route, Trajectory(kind=kind, gaze_deg=20), 10, SEED)
        step_s, stamps_s = 1e-4, np.linspace(-0.5, 10.5, 200)
        before, after = (motion.T_world_cam(stamps_s + s * step_s / 2) for s in (-1, 1))
        np.testing.assert_allclose(
            motion.velocity_mps(stamps_s), (after - before)[:, :3, 3] / step_s, atol=1e-5
        )
        turned = np.swapaxes(before[:, :3, :3], 1, 2) @ after[:, :3, :3]
        rate = Rotation.from_matrix(turned).as_rotvec() / step_s
        np.testing.assert_allclose(motion.rate_radps(stamps_s), rate, atol=1e-5)

    def test_seeds_vary_the_motion_and_repeat_it(self, kind, route):
        one, same, other = (
            plan_motion(route, Trajectory(kind=kind), 4, seed).T_world_cam(2.0) for seed in (1, 1, 2)
        )
        np.testing.assert_array_equal(one, same)
        assert np.abs(one - other).max() > 1e-3


def test_every_kind_of_motion_is_tested():
    assert {kind for kind, _ in CASES} == set(KINDS)


def test_a_walk_is_the_default():
    assert Trajectory() == Trajectory(kind="walk")
    walk, plain = (plan(CORNERS, Trajectory(), 10, 2).T_world_cam(5.0) for plan in (plan_motion, plan_walk))
    np.testing.assert_array_equal(walk, plain)


class TestCar:
    def test_it_moves_where_it_points(self):
        motion = plan_motion(STREETS, Trajectory(kind="car"), 30, 1)
        stamps_s = np.arange(0, 30, 0.01)
        velocity, T = motion.velocity_mps(stamps_s), motion.T_world_cam(stamps_s)
        aside = np.einsum("nk,nk->n", velocity, T[:, :3, 0])
        ahead = np.einsum("nk,nk->n", velocity, T[:, :3, 2])
        assert np.abs(aside / ahead).max() < 0.01
        assert ahead.min() > 1

    def test_it_brakes_for_corners_and_keeps_to_its_acceleration(self):
        trajectory = Trajectory(kind="car")
        motion = plan_motion(STREETS, trajectory, 40, 1)
        stamps_s = np.arange(0, 40, 0.01)
        velocity = motion.velocity_mps(stamps_s)[:, :2]
        speed = np.linalg.norm(velocity, axis=1)
        assert speed.min() < 6 and speed.max() > 8.5
        accel = np.diff(velocity, axis=0) / 0.01
        along = np.einsum("nk,nk->n", accel, velocity[1:]) / speed[1:]
        assert np.abs(along).max() <= trajectory.max_accel_mps2
        # Along and across share the tyres; each alone keeps to the limit.
        assert np.linalg.norm(accel, axis=1).max() <= np.sqrt(2) * trajectory.max_accel_mps2

    def test_a_loop_is_driven_round_and_comes_back(self):
        motion = plan_motion(LOOP, Trajectory(kind="car"), 80, 1)
        stamps_s = np.arange(0, 80, 0.1)
        centres = motion.T_world_cam(stamps_s)[:, :2, 3]
        later = np.linalg.norm(centres[0] - centres[300:], axis=1)
        assert later.min() < 1.5
        assert np.linalg.norm(motion.velocity_mps(stamps_s), axis=1).mean() * 80 > 1.2 * 400

    def test_it_dives_when_it_brakes_and_shakes_on_its_springs(self):
        still, shaken = (
            plan_motion(STREETS, Trajectory(kind="car", shake_deg=s, sway_m=0), 40, 1) for s in (0.0, 1.0)
        )
        stamps_s = np.arange(0, 40, 0.05)
        pitch = np.arcsin(still.T_world_cam(stamps_s)[:, 2, 2])
        velocity = still.velocity_mps(stamps_s)
        braking = np.gradient(np.linalg.norm(velocity, axis=1), 0.05) < -1.0
        assert braking.any() and np.rad2deg(pitch[braking]).mean() < -0.2
        other = np.arcsin(shaken.T_world_cam(stamps_s)[:, 2, 2])
        assert 0.1 < np.rad2deg(np.std(other - pitch)) < 1.0


def test_a_hand_held_camera_bobs_at_the_frequency_of_the_steps():
    straight = Route(np.array([[0.0, 0], [100, 0]]), 0.5, False)
    motion = plan_motion(straight, Trajectory(kind="handheld", step_hz=2.0), 40, 0)
    stamps_s = np.arange(0, 40, 0.02)
    height = motion.T_world_cam(stamps_s)[:, 2, 3]
    power = np.abs(np.fft.rfft(height - height.mean())) ** 2
    hertz = np.fft.rfftfreq(len(height), 0.02)
    above = hertz > 1.0
    assert hertz[above][np.argmax(power[above])] == pytest.approx(2.0, abs=0.25)


def test_gusts_push_a_drone_and_it_leans_against_them():
    # The mean wind, and so the push, differs from seed to seed; calm air is the same flight without it.
    calm, blown = (plan_motion(STREETS, Trajectory(kind="drone", gust_mps=g), 12, 4) for g in (0.0, 4.0))
    stamps_s = np.arange(0, 12, 0.05)
    off = (blown.T_world_cam(stamps_s) - calm.T_world_cam(stamps_s))[:, :3, 3]
    assert 0.02 < np.linalg.norm(off, axis=1).std() + np.linalg.norm(off, axis=1).mean() < STREETS.clearance_m
    tilt = np.arccos(-blown.T_world_cam(stamps_s)[:, 2, 1])
    assert np.rad2deg(tilt).max() > 1


def test_pace_is_lowered_until_brakes_and_engine_can_follow():
    along_m = np.linspace(0, 100, 1001)
    wanted = np.full(1001, 10.0)
    wanted[500] = 2.0
    pace = limited_pace(wanted, along_m, 2.0)
    assert (pace <= wanted).all() and pace[500] == 2.0
    accel = np.diff(pace**2) / (2 * np.diff(along_m))
    assert np.abs(accel).max() <= 2.0 + 1e-9
    # v^2 = 2^2 + 2 a s: the wanted speed is reached again after 24 m.
    assert pace[500 + 245] == pytest.approx(10.0) and pace[500 + 235] < 10.0


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"kind": "walk", "gust_mps": 1.0}, "walk has no gust_mps"),
        ({"kind": "car", "step_hz": 1.0}, "car has no step_hz"),
        ({"kind": "drone", "max_accel_mps2": 0.0}, "cannot move"),
    ],
)
def test_fields_of_another_kind_are_bad_input(fields, message):
    with pytest.raises(ValueError, match=message):
        Trajectory(**fields)


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_sets_defaults_that_given_fields_replace(kind):
    own = Trajectory(kind=kind)
    for name, value in KINDS[kind].items():
        assert getattr(own, name) == value
    assert Trajectory(kind=kind, max_speed_mps=3.0).max_speed_mps == 3.0
    assert Trajectory(**own.model_dump()) == own
    assert PAD_S >= 1.0


def test_a_hand_held_camera_looks_about_while_it_goes_the_same_way():
    straight = Route(np.array([[0.0, 0], [100, 0]]), 0.5, False)
    still, about = (
        plan_motion(straight, Trajectory(kind="handheld", shake_deg=0, max_speed_mps=0.3, look_deg=a), 60, 0)
        for a in (0.0, 10.0)
    )
    stamps_s = np.arange(0, 60, 0.1)
    one, two = still.T_world_cam(stamps_s), about.T_world_cam(stamps_s)
    np.testing.assert_allclose(one[:, :3, 3], two[:, :3, 3], atol=1e-9)
    angle_deg = np.degrees(np.arccos(np.clip(np.einsum("nk,nk->n", one[:, :3, 2], two[:, :3, 2]), -1, 1)))
    assert 6 < angle_deg.max() < 14 and np.median(angle_deg) > 2
    with pytest.raises(ValueError, match="look_deg"):
        Trajectory(kind="car", look_deg=3)
