"""Car motion: moves where it points, brakes before corners, dives, rolls and shakes."""

import math

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from dslab.scenarios.motions import Trajectory
from dslab.scenarios.seeds import rng_for
from dslab.sim.motion.path import STEP_M, ground, smooth_path
from dslab.sim.motion.planning import knot_times, limited_pace, long_enough, progress, sway, within_limits
from dslab.sim.motion.spline import PoseSpline
from dslab.sim.worlds.base import Route
from dslab.sim.worlds.geometry.route import arc_length

_KNOT_S = 0.05
# The plan stays this far below the limits; springs and spline use the rest.
_SPEED_SHARE, _RATE_SHARE, _ACCEL_SHARE = 0.97, 0.85, 0.9
_WANDER_M, _STEERING_M = 15.0, 1.2  # smoothing of the sideways wander and of the steering
_MOOD_M, _MOOD_SHARE = 30.0, 0.08  # the driver's speed varies by this share over this distance
_DIVE_DEG_PER_MPS2, _LEAN_DEG_PER_MPS2 = 0.35, 0.45
_SPRING_HZ = (1.1, 2.6)


def plan_car(route: Route, trajectory: Trajectory, duration_s: float, seed: int) -> PoseSpline:
    """Plan a car's camera within its limits of speed, acceleration and angular rate.

    A closed route is driven round and round from a seeded start; an open one from its start, more slowly
    if it is too short for the duration. The car already moves when the sequence begins. Its direction is the
    path's tangent (nonholonomic); the camera sits at ``eye_height_m`` over the path.

    Arguments as of ``sim.motion.plan_motion``.
    """
    rng = rng_for(seed, "motion", "path")
    line = smooth_path(route, rng, wander_sigma_m=_WANDER_M, softening_m=_STEERING_M)
    line = long_enough(line, route, trajectory, duration_s, seed)
    along_m = arc_length(line)
    heading, curvature = _steering(line, along_m)
    knots_s = knot_times(duration_s, _KNOT_S)
    pace = _pace(along_m, curvature, trajectory, rng_for(seed, "motion", "pace"))
    at_m = progress(along_m, pace, knots_s)

    path = CubicSpline(along_m, np.column_stack([line[:, :2], *ground(line), heading]))(at_m)
    speed = np.gradient(at_m, knots_s)
    accel = gaussian_filter1d(np.gradient(speed, knots_s), 0.2 / _KNOT_S)
    across = gaussian_filter1d(speed**2 * np.interp(at_m, along_m, curvature), 0.2 / _KNOT_S)

    rng = rng_for(seed, "motion", "springs")
    heave, nod, roll = (sway(knots_s, rng, _SPRING_HZ) * speed / trajectory.max_speed_mps for _ in range(3))
    shake = math.radians(trajectory.shake_deg)
    pitch = math.radians(_DIVE_DEG_PER_MPS2) * accel + shake * nod
    # Positive roll is to the right: the body leans outward.
    lean = math.radians(_LEAN_DEG_PER_MPS2) * across + shake * roll
    eye = trajectory.eye_height_m + trajectory.sway_m * heave
    position = np.column_stack([path[:, :2], eye + path[:, 2]])
    turns = np.column_stack([path[:, 4] + math.radians(trajectory.gaze_deg), pitch + path[:, 3], lean])
    return within_limits(knots_s, position, turns, trajectory, duration_s)


def _steering(line: np.ndarray, along_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(M,) tangent direction, radians from +x, and (M,) its change per metre, positive left."""
    tangent = np.gradient(line, along_m, axis=0)
    heading = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    return heading, gaussian_filter1d(np.gradient(heading, along_m), 0.3 / STEP_M, mode="nearest")


def _pace(
    along_m: np.ndarray, curvature: np.ndarray, trajectory: Trajectory, rng: np.random.Generator
) -> np.ndarray:
    """(M,) speed along the line, limited by the driver, the corners and the brakes."""
    mood = gaussian_filter1d(rng.standard_normal(len(along_m)), _MOOD_M / STEP_M, mode="nearest")
    mood /= max(float(np.abs(mood).max()), 1e-12)
    wanted = _SPEED_SHARE * trajectory.max_speed_mps * (1 - _MOOD_SHARE * (1 + mood) / 2)
    bend = np.maximum(np.abs(curvature), 1e-9)
    accel = _ACCEL_SHARE * trajectory.max_accel_mps2
    turning = _RATE_SHARE * math.radians(trajectory.max_rate_degps) / bend
    pace = np.minimum.reduce([wanted, np.sqrt(accel / bend), turning])
    # Smoothing rounds the changes of acceleration; the margin of the limits absorbs what it adds.
    return gaussian_filter1d(limited_pace(pace, along_m, accel), 1.0 / STEP_M, mode="nearest")
