"""Walking motion: a steady pace along the route, slower around corners, with a little sway.

A hand-held camera also bobs with each step and trembles.
"""

import math

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from dslab.scenarios.seeds import rng_for
from dslab.scenarios.spec import Trajectory
from dslab.sim.motion.path import STEP_M, ground, smooth_path
from dslab.sim.motion.planning import PAD_S, knot_times, long_enough, progress, sway, within_limits
from dslab.sim.motion.spline import PoseSpline
from dslab.sim.worlds.base import Route
from dslab.sim.worlds.geometry.route import arc_length

__all__ = ["PAD_S", "plan_handheld", "plan_walk"]

_KNOT_S, _STEP_KNOT_S = 0.2, 0.04
# The plan stays this far below the limits; sway and wander use the rest.
_SPEED_SHARE, _RATE_SHARE = 0.9, 0.8
_SWAY_CLEARANCE_SHARE = 0.12
_SWAY_DEG = (1.5, 1.2, 0.8)  # yaw, pitch, roll
_LOOK_AHEAD_S = 0.5  # standard deviation of the time over which the gaze smooths the direction of travel
_TREMBLE_HZ = (3.0, 8.0)
_TREMBLE_SHARE = 0.4
_LOOK_HZ = (0.1, 0.35)
_LOOK_SHARES = np.array([1.0, 0.75, 0.75])  # of yaw, pitch, roll
_STAIR_PACE = 0.6  # share of the pace lost per sine of the slope: two thirds remain on a stair of 33 degrees
_STAIR_GAZE = 0.35  # share of the slope by which the gaze follows it up or down


def plan_walk(route: Route, trajectory: Trajectory, duration_s: float, seed: int) -> PoseSpline:
    """Plan a walk along a route within the trajectory's limits of speed and angular rate.

    A closed route is walked round and round from a seeded start; an open one from its start, more slowly
    if it is too short for the duration.

    Arguments as of ``sim.motion.plan_motion``.
    """
    knots_s = knot_times(duration_s, _KNOT_S)
    position, turns = _walked(route, trajectory, duration_s, seed, knots_s)
    return within_limits(knots_s, position, turns, trajectory, duration_s)


def plan_handheld(route: Route, trajectory: Trajectory, duration_s: float, seed: int) -> PoseSpline:
    """Plan a walk with a hand-held camera; arguments as for ``plan_walk``.

    The body rises with each step and leans towards the standing leg; the hands nod and roll with it by
    ``shake_deg`` and tremble, and the camera looks about by ``look_deg``.
    """
    knots_s = knot_times(duration_s, _STEP_KNOT_S)
    position, turns = _walked(route, trajectory, duration_s, seed, knots_s)
    rng = rng_for(seed, "motion", "gait")
    # The step frequency drifts by a few per cent.
    drift = 0.05 * np.cumsum(sway(knots_s, rng)) * _STEP_KNOT_S
    steps = 2 * np.pi * (trajectory.step_hz * (knots_s + drift) + rng.random())
    position[:, 2] += trajectory.sway_m * np.sin(steps)
    lean = 0.6 * min(trajectory.sway_m, 0.12 * route.clearance_m) * np.sin(steps / 2)
    yaw = turns[:, 0] - math.radians(trajectory.gaze_deg)
    position[:, :2] += lean[:, None] * np.column_stack([-np.sin(yaw), np.cos(yaw)])
    shake = math.radians(trajectory.shake_deg)
    turns[:, 1] += shake * np.sin(steps + rng.uniform(0, 2 * np.pi))
    turns[:, 2] += shake * np.sin(steps / 2 + rng.uniform(0, 2 * np.pi))
    tremble = np.column_stack([sway(knots_s, rng, _TREMBLE_HZ) for _ in range(3)])
    turns += _TREMBLE_SHARE * shake * tremble
    if trajectory.look_deg:
        rng = rng_for(seed, "motion", "look")
        about = np.column_stack([sway(knots_s, rng, _LOOK_HZ) for _ in range(3)])
        turns += math.radians(trajectory.look_deg) * _LOOK_SHARES * about
    return within_limits(knots_s, position, turns, trajectory, duration_s)


def _walked(
    route: Route, trajectory: Trajectory, duration_s: float, seed: int, knots_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(M, 3) positions and (M, 3) yaw, pitch, roll at the knots."""
    line = long_enough(
        smooth_path(route, rng_for(seed, "motion", "path")), route, trajectory, duration_s, seed
    )
    along_m = arc_length(line)
    heading = _gaze_heading(line, trajectory.max_speed_mps)
    height, slope = ground(line)
    pace = _pace(along_m, heading, trajectory) * (1 - _STAIR_PACE * np.abs(np.sin(slope)))
    at_m = progress(along_m, pace, knots_s)

    rng = rng_for(seed, "motion", "sway")
    sideways, upward = (sway(knots_s, rng) for _ in range(2))
    turns = np.deg2rad(_SWAY_DEG) * np.column_stack([sway(knots_s, rng) for _ in range(3)])
    path = CubicSpline(along_m, np.column_stack([line[:, :2], height, slope, heading]))(at_m)
    yaw = path[:, 4]
    amplitude_m = min(trajectory.sway_m, _SWAY_CLEARANCE_SHARE * route.clearance_m)
    normal = np.column_stack([-np.sin(yaw), np.cos(yaw)])
    plan = path[:, :2] + amplitude_m * sideways[:, None] * normal
    eye = trajectory.eye_height_m + trajectory.sway_m * upward
    position = np.column_stack([plan, eye + path[:, 2]])
    turns[:, 0] += yaw + math.radians(trajectory.gaze_deg)
    turns[:, 1] += _STAIR_GAZE * math.cos(math.radians(trajectory.gaze_deg)) * path[:, 3]
    return position, turns


def _gaze_heading(line: np.ndarray, speed_mps: float) -> np.ndarray:
    """(M,) direction of travel, radians from +x, smoothed: eyes turn before a corner."""
    tangent = np.gradient(line, axis=0)
    heading = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    return gaussian_filter1d(heading, _LOOK_AHEAD_S * speed_mps / STEP_M, mode="nearest")


def _pace(along_m: np.ndarray, heading: np.ndarray, trajectory: Trajectory) -> np.ndarray:
    """(M,) speed along the line allowed by the turns of the heading."""
    curvature = np.abs(np.gradient(heading, along_m))
    turning = _RATE_SHARE * math.radians(trajectory.max_rate_degps) / np.maximum(curvature, 1e-9)
    pace = np.minimum(_SPEED_SHARE * trajectory.max_speed_mps, turning)
    return gaussian_filter1d(pace, 0.4 / STEP_M, mode="nearest")
