"""Motion over stairs and slopes: the eye keeps its height over the ground, limits hold in 3D."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dslab.scenarios.motions import KINDS, Trajectory
from dslab.sim.motion import plan_motion
from dslab.sim.motion.base import Motion
from dslab.sim.motion.path import arc_length, ground, smooth_path
from dslab.sim.worlds.base import Route

CORNERS = np.array([[0.0, 0], [10, 0], [10, 6], [16, 6], [16, 12], [30, 12]])
LEVELS = np.array([0.0, 0, 0, 3.5, 3.5, 3.5])
STAIRS = Route(CORNERS, 0.6, False, LEVELS)
RING = Route(np.array([[0.0, 0], [12, 0], [12, 8], [0, 8]]), 0.6, True, np.array([0.0, 0, 3, 3]))
SLOPE_RAD = np.arctan(3.5 / 6)
SEED = 1


def kind(name: str, **fields: float) -> Trajectory:
    """A motion slow enough to turn these corners."""
    own = {"max_speed_mps": 1.2, "max_rate_degps": 60.0, "eye_height_m": 1.5}
    return Trajectory(kind=name, **{**own, **fields})


@cache
def planned(name: str) -> Motion:
    """The motion over the stairs in 30 s."""
    return plan_motion(STAIRS, kind(name), 30, SEED)


def height_below(centres: np.ndarray, route: Route) -> np.ndarray:
    """(N,) height of the route's ground at its point nearest in plan."""
    line = np.column_stack([route.centre_m, route.height_m])
    if route.closed:
        line = np.vstack([line, line[:1]])
    best, found = np.full(len(centres), np.inf), np.zeros(len(centres))
    for a, b in pairwise(line):
        way = (b - a)[:2]
        share = np.clip((centres[:, :2] - a[:2]) @ way / (way @ way), 0, 1)
        off = np.linalg.norm(centres[:, :2] - a[:2] - share[:, None] * way, axis=1)
        found = np.where(off < best, a[2] + share * (b[2] - a[2]), found)
        best = np.minimum(best, off)
    return found


@pytest.mark.parametrize("name", KINDS)
class TestEveryMotion:
    def test_the_eye_keeps_its_height_over_the_ground(self, name):
        motion = plan_motion(STAIRS, kind(name, sway_m=0.0), 35, SEED)
        centres = motion.T_world_cam(np.arange(0, 35, 0.05))[:, :3, 3]
        # Where the slope begins, at a corner, it is rounded off: most for a car. Gusts move a drone.
        off = centres[:, 2] - height_below(centres, STAIRS) - 1.5
        assert np.abs(off).max() < {"drone": 0.6, "car": 0.45}.get(name, 0.3)
        assert np.abs(np.median(off)) < 0.06
        assert np.ptp(centres[:, 2]) > 3.3

    def test_speed_and_rate_keep_to_their_limits_in_three_dimensions(self, name):
        motion = planned(name)
        stamps_s = np.arange(0, 30, 0.004)
        velocity = motion.velocity_mps(stamps_s)
        assert np.linalg.norm(velocity, axis=1).max() <= 1.2
        assert np.rad2deg(np.linalg.norm(motion.rate_radps(stamps_s), axis=1)).max() <= 60
        assert velocity[:, 2].max() > 0.2

    def test_velocity_and_rate_are_the_derivatives_of_the_pose(self, name):
        motion = planned(name)
        step_s, stamps_s = 1e-4, np.linspace(0.5, 29.5, 150)
        before, after = (motion.T_world_cam(stamps_s + s * step_s / 2) for s in (-1, 1))
        velocity = (after - before)[:, :3, 3] / step_s
        np.testing.assert_allclose(motion.velocity_mps(stamps_s), velocity, atol=1e-5)
        turned = np.swapaxes(before[:, :3, :3], 1, 2) @ after[:, :3, :3]
        rate = Rotation.from_matrix(turned).as_rotvec() / step_s
        np.testing.assert_allclose(motion.rate_radps(stamps_s), rate, atol=1e-5)

    def test_level_and_raised_floors_keep_the_path(self, name):
        stamps_s = np.linspace(0, 10, 50)
        flat, *level = (
            plan_motion(Route(CORNERS, 0.6, False, heights), kind(name), 10, SEED).T_world_cam(stamps_s)
            for heights in (None, np.zeros(len(CORNERS)), np.full(len(CORNERS), 6.4))
        )
        np.testing.assert_allclose(level[0], flat, atol=1e-9)
        np.testing.assert_allclose(
            level[1][:, :3, 3] - flat[:, :3, 3], np.tile([0, 0, 6.4], (50, 1)), atol=1e-6
        )


@pytest.mark.parametrize("route", [STAIRS, RING], ids=["stairs", "ring"])
def test_the_path_keeps_its_plan_and_its_height_has_no_kink(route):
    flat = Route(route.centre_m, route.clearance_m, route.closed)
    line, plain = (smooth_path(r, np.random.default_rng(0)) for r in (route, flat))
    np.testing.assert_allclose(line[:, :2], plain, atol=1e-9)
    slope = np.diff(line[:, 2]) / np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1)
    assert np.abs(slope).max() < 1.1 * np.abs(np.diff(route.height_m)).max() / 6
    assert np.abs(np.diff(slope)).max() < 0.08
    assert line[:, 2].min() > -0.01 and line[:, 2].max() < route.height_m.max() + 0.01


def test_length_and_slope_follow_the_ground():
    line = smooth_path(STAIRS, np.random.default_rng(0))
    height, slope = ground(line)
    np.testing.assert_array_equal(height, line[:, 2])
    assert arc_length(line)[-1] > arc_length(line[:, :2])[-1] + 0.7
    assert slope.max() == pytest.approx(SLOPE_RAD, abs=0.06)
    assert not any(column.any() for column in ground(line[:, :2]))


def test_a_walker_is_slower_on_stairs_and_looks_along_their_slope():
    down = Route(CORNERS[::-1], 0.6, False, LEVELS[::-1])
    pitches = []
    for route in (STAIRS, down):
        motion = plan_motion(route, kind("walk", sway_m=0.0, max_rate_degps=200.0), 28, 0)
        stamps_s = np.arange(0, 28, 0.05)
        T, velocity = motion.T_world_cam(stamps_s), motion.velocity_mps(stamps_s)
        steep = np.abs(velocity[:, 2]) > 0.35 * np.linalg.norm(velocity, axis=1)
        flat = np.abs(velocity[:, 2]) < 0.01
        speed = np.linalg.norm(velocity, axis=1)
        assert np.median(speed[steep]) < 0.8 * speed[flat].max()
        pitches.append(np.rad2deg(np.arcsin(T[steep, 2, 2])).mean())
    assert pitches[0] > 4 and pitches[1] < -4


def test_a_closed_route_with_heights_is_walked_round_and_round():
    motion = plan_motion(RING, kind("walk", max_speed_mps=2.0, sway_m=0.0), 90, 0)
    stamps_s = np.arange(0, 90, 0.02)
    centres = motion.T_world_cam(stamps_s)[:, :3, 3]
    assert np.abs(np.diff(centres[:, 2])).max() < 0.04
    assert (np.diff((centres[:, 2] > 1.5 + 1.5).astype(int)) == 1).sum() >= 3
    assert np.abs(centres[:, 2] - height_below(centres, RING) - 1.5).max() < 0.3
