"""Shared steps of motion planning: closed routes, progress, sway, limits."""

import math

import numpy as np
from scipy.interpolate import CubicSpline

from dslab.scenarios.motions import Trajectory
from dslab.scenarios.seeds import rng_for
from dslab.sim.motion.path import STEP_M
from dslab.sim.motion.spline import PoseSpline
from dslab.sim.worlds.base import Route

# Exposures reach beyond the first and the last frame.
PAD_S = 1.0


def knot_times(duration_s: float, step_s: float) -> np.ndarray:
    """(M,) knot times of a spline that covers a sequence and its padding."""
    return np.arange(-PAD_S - 3 * step_s, duration_s + PAD_S + 3 * step_s, step_s)


def long_enough(
    line: np.ndarray, route: Route, trajectory: Trajectory, duration_s: float, seed: int
) -> np.ndarray:
    """Unroll a closed line from a seeded start over enough rounds."""
    if not route.closed:
        return line
    start = int(rng_for(seed, "motion", "start").integers(len(line)))
    need_m = (duration_s + 4 * PAD_S) * trajectory.max_speed_mps
    rounds = math.ceil(need_m / (len(line) * STEP_M)) + 1
    return np.tile(np.roll(line, -start, axis=0), (rounds, 1))


def progress(along_m: np.ndarray, pace: np.ndarray, knots_s: np.ndarray) -> np.ndarray:
    """Arc length at each knot for a pace (m/s); slower on a short line."""
    slowness = 1 / pace
    steps_s = np.diff(along_m) * (slowness[1:] + slowness[:-1]) / 2
    reached_s = np.concatenate([[0.0], np.cumsum(steps_s)])
    needed_s = knots_s[-1] - knots_s[0]
    if reached_s[-1] < needed_s:
        reached_s *= needed_s / reached_s[-1]
    return CubicSpline(reached_s, along_m)(knots_s - knots_s[0])


def limited_pace(pace: np.ndarray, along_m: np.ndarray, accel_mps2: float) -> np.ndarray:
    """The highest pace below the given one within an acceleration limit."""
    squared = pace**2
    gain = 2 * accel_mps2 * np.diff(along_m)
    for k in range(1, len(squared)):
        squared[k] = min(squared[k], squared[k - 1] + gain[k - 1])
    for k in range(len(squared) - 2, -1, -1):
        squared[k] = min(squared[k], squared[k + 1] + gain[k])
    return np.sqrt(squared)


def sway(
    knots_s: np.ndarray, rng: np.random.Generator, hertz: tuple[float, float] = (0.25, 0.7)
) -> np.ndarray:
    """A sum of three sines with seeded frequencies and phases, within [-1, 1]."""
    weights = np.array([0.5, 0.3, 0.2])
    frequencies = rng.uniform(*hertz, 3)
    phases = rng.uniform(0, 2 * np.pi, 3)
    return np.sin(2 * np.pi * knots_s[:, None] * frequencies + phases) @ weights


def within_limits(
    knots_s: np.ndarray,
    position_m: np.ndarray,
    yaw_pitch_roll: np.ndarray,
    trajectory: Trajectory,
    duration_s: float,
) -> PoseSpline:
    """The spline through the knots, slowed down to the limits of speed and rate."""
    plan = PoseSpline(knots_s, position_m, yaw_pitch_roll)
    return PoseSpline(knots_s, position_m, yaw_pitch_roll, _excess(plan, trajectory, duration_s))


def _excess(plan: PoseSpline, trajectory: Trajectory, duration_s: float) -> float:
    """Factor by which the plan's measured peaks exceed the limits, at least 1."""
    stamps_s = np.arange(-PAD_S, duration_s + PAD_S, 0.01)
    speed = np.linalg.norm(plan.velocity_mps(stamps_s), axis=-1).max()
    rate = np.linalg.norm(plan.rate_radps(stamps_s), axis=-1).max()
    # The margin covers peaks between the samples.
    return max(
        1.0, 1.001 * speed / trajectory.max_speed_mps, 1.001 * rate / math.radians(trajectory.max_rate_degps)
    )
