"""A walking carrier: along the route at a steady pace, slower around corners, swaying a little."""

import math

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from scenarios.seeds import rng_for
from scenarios.spec import Trajectory
from sim.motion.path import STEP_M, arc_length, smooth_path
from sim.motion.spline import PoseSpline
from sim.world.base import Route

# Exposures reach beyond the first and the last frame.
PAD_S = 1.0
_KNOT_S = 0.2
# The plan stays this far below the limits, which sway and wander then use up.
_SPEED_SHARE, _RATE_SHARE = 0.9, 0.8
_SWAY_CLEARANCE_SHARE = 0.12
_SWAY_HZ = (0.25, 0.7)
_SWAY_DEG = (1.5, 1.2, 0.8)  # yaw, pitch, roll
_LOOK_AHEAD_S = 0.5  # the gaze smooths the direction of travel over this time, standard deviation


def plan_walk(route: Route, trajectory: Trajectory, duration_s: float, seed: int) -> PoseSpline:
    """The motion of a carrier along a route, within the trajectory's limits of speed and angular rate.

    A closed route is walked round and round from a seeded start; an open one from its start, more slowly
    if it is too short for the duration.

    Args:
        route: free space to move in.
        trajectory: limits, gaze, eye height and sway.
        duration_s: the motion is defined from ``-PAD_S`` to ``duration_s + PAD_S``.
        seed: root seed; the streams are ``("motion", ...)``.
    """
    line = _long_enough(
        smooth_path(route, rng_for(seed, "motion", "path")), route, trajectory, duration_s, seed
    )
    knots_s = np.arange(-PAD_S - 3 * _KNOT_S, duration_s + PAD_S + 3 * _KNOT_S, _KNOT_S)
    along_m = arc_length(line)
    heading = _gaze_heading(line, trajectory.max_speed_mps)
    at_m = _progress(along_m, heading, trajectory, knots_s)

    rng = rng_for(seed, "motion", "sway")
    sideways, upward = (_sway(knots_s, rng) for _ in range(2))
    turns = np.deg2rad(_SWAY_DEG) * np.column_stack([_sway(knots_s, rng) for _ in range(3)])
    yaw = CubicSpline(along_m, heading)(at_m)
    amplitude_m = min(trajectory.sway_m, _SWAY_CLEARANCE_SHARE * route.clearance_m)
    normal = np.column_stack([-np.sin(yaw), np.cos(yaw)])
    ground = CubicSpline(along_m, line)(at_m) + amplitude_m * sideways[:, None] * normal
    position = np.column_stack([ground, trajectory.eye_height_m + trajectory.sway_m * upward])
    turns[:, 0] += yaw + math.radians(trajectory.gaze_deg)

    plan = PoseSpline(knots_s, position, turns)
    return PoseSpline(knots_s, position, turns, _excess(plan, trajectory, duration_s))


def _long_enough(
    line: np.ndarray, route: Route, trajectory: Trajectory, duration_s: float, seed: int
) -> np.ndarray:
    """A closed line unrolled from a seeded start over as many rounds as can be needed."""
    if not route.closed:
        return line
    start = int(rng_for(seed, "motion", "start").integers(len(line)))
    need_m = (duration_s + 4 * PAD_S) * trajectory.max_speed_mps
    rounds = math.ceil(need_m / (len(line) * STEP_M)) + 1
    return np.tile(np.roll(line, -start, axis=0), (rounds, 1))


def _gaze_heading(line: np.ndarray, speed_mps: float) -> np.ndarray:
    """(M,) direction of travel, radians from +x, smoothed as by eyes that look into a corner before it."""
    tangent = np.gradient(line, axis=0)
    heading = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    return gaussian_filter1d(heading, _LOOK_AHEAD_S * speed_mps / STEP_M, mode="nearest")


def _progress(
    along_m: np.ndarray, heading: np.ndarray, trajectory: Trajectory, knots_s: np.ndarray
) -> np.ndarray:
    """Arc length at each knot, at a pace that the turns of the heading allow."""
    curvature = np.abs(np.gradient(heading, along_m))
    turning = _RATE_SHARE * math.radians(trajectory.max_rate_degps) / np.maximum(curvature, 1e-9)
    pace = np.minimum(_SPEED_SHARE * trajectory.max_speed_mps, turning)
    pace = gaussian_filter1d(pace, 0.4 / STEP_M, mode="nearest")
    slowness = 1 / pace
    steps_s = np.diff(along_m) * (slowness[1:] + slowness[:-1]) / 2
    reached_s = np.concatenate([[0.0], np.cumsum(steps_s)])
    needed_s = knots_s[-1] - knots_s[0]
    if reached_s[-1] < needed_s:
        reached_s *= needed_s / reached_s[-1]
    return CubicSpline(reached_s, along_m)(knots_s - knots_s[0])


def _sway(knots_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A sum of three sines with seeded frequencies and phases, within [-1, 1]."""
    weights = np.array([0.5, 0.3, 0.2])
    hertz = rng.uniform(*_SWAY_HZ, 3)
    phases = rng.uniform(0, 2 * np.pi, 3)
    return np.sin(2 * np.pi * knots_s[:, None] * hertz + phases) @ weights


def _excess(plan: PoseSpline, trajectory: Trajectory, duration_s: float) -> float:
    """By how much the plan's measured peaks exceed the limits, at least 1."""
    stamps_s = np.arange(-PAD_S, duration_s + PAD_S, 0.01)
    speed = np.linalg.norm(plan.velocity_mps(stamps_s), axis=-1).max()
    rate = np.linalg.norm(plan.rate_radps(stamps_s), axis=-1).max()
    # The margin covers peaks between the samples.
    return max(
        1.0, 1.001 * speed / trajectory.max_speed_mps, 1.001 * rate / math.radians(trajectory.max_rate_degps)
    )
