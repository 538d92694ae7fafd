"""Drone motion: a free body in MuJoCo that follows the route against gusts."""

import math

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from dslab.scenarios.motions import Trajectory
from dslab.scenarios.seeds import rng_for
from dslab.sim.motion.path import STEP_M, ground, smooth_path
from dslab.sim.motion.planning import knot_times, limited_pace, long_enough, progress, within_limits
from dslab.sim.motion.spline import PoseSpline
from dslab.sim.worlds.base import Route
from dslab.sim.worlds.geometry.route import arc_length

import mujoco  # isort: skip

_KNOT_S, _STEPS_PER_KNOT = 0.05, 10
_SPEED_SHARE, _RATE_SHARE, _ACCEL_SHARE = 0.85, 0.7, 0.8
_GRAVITY_MPS2 = 9.81
_STIFFNESS, _DAMPING = 9.0, 5.0  # of the position, per second squared and per second
_TURN_STIFFNESS, _TURN_DAMPING = 60.0, 14.0  # of the attitude
_DRAG = 0.25  # acceleration per relative wind, 1/s
_GUST_S = 1.2  # correlation time of the wind
_WIND_CLEARANCE_SHARE = 0.5  # share of the free space that the wind may use
_MOST_LEAN_RAD = math.radians(20.0)
_BODY = f"""
<mujoco>
  <option timestep="{_KNOT_S / _STEPS_PER_KNOT}" gravity="0 0 -{_GRAVITY_MPS2}" integrator="implicitfast"/>
  <worldbody>
    <body name="drone">
      <freejoint/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    </body>
  </worldbody>
</mujoco>
"""


def plan_drone(route: Route, trajectory: Trajectory, duration_s: float, seed: int) -> PoseSpline:
    """Plan a drone's camera in gusts, within its limits of speed and rate.

    The body is simulated; its poses become a spline, so that velocity and rate are known in closed form.

    Arguments as of ``sim.motion.plan_motion``.
    """
    knots_s = knot_times(duration_s, _KNOT_S)
    wanted = _wanted(route, trajectory, duration_s, seed, knots_s)
    wind = _wind(len(knots_s), trajectory.gust_mps, rng_for(seed, "motion", "wind"))
    # In a steady wind w, the body is displaced by drag w / stiffness.
    most_mps = _WIND_CLEARANCE_SHARE * route.clearance_m * _STIFFNESS / _DRAG
    wind *= min(1.0, most_mps / max(float(np.abs(wind).max()), 1e-9))
    position, turns = _fly(wanted, wind)
    turns[:, 0] += math.radians(trajectory.gaze_deg)
    return within_limits(knots_s, position, turns, trajectory, duration_s)


def _wanted(
    route: Route, trajectory: Trajectory, duration_s: float, seed: int, knots_s: np.ndarray
) -> np.ndarray:
    """(M, 4) desired position and yaw at the knots."""
    line = smooth_path(route, rng_for(seed, "motion", "path"), softening_m=0.5)
    line = long_enough(line, route, trajectory, duration_s, seed)
    along_m = arc_length(line)
    tangent = np.gradient(line, along_m, axis=0)
    heading = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    heading = gaussian_filter1d(heading, 0.4 * trajectory.max_speed_mps / STEP_M, mode="nearest")
    bend = np.maximum(np.abs(np.gradient(heading, along_m)), 1e-9)
    accel = _ACCEL_SHARE * trajectory.max_accel_mps2
    turning = _RATE_SHARE * math.radians(trajectory.max_rate_degps) / bend
    cruise = np.full(len(line), _SPEED_SHARE * trajectory.max_speed_mps)
    pace = limited_pace(np.minimum.reduce([cruise, np.sqrt(accel / bend), turning]), along_m, accel)
    at_m = progress(along_m, gaussian_filter1d(pace, 0.5 / STEP_M, mode="nearest"), knots_s)
    path = CubicSpline(along_m, np.column_stack([line[:, :2], ground(line)[0], heading]))(at_m)
    return path + np.array([0.0, 0.0, trajectory.eye_height_m, 0.0])


def _wind(count: int, gust_mps: float, rng: np.random.Generator) -> np.ndarray:
    """(M, 3) wind at the knots: coloured noise, weaker upward."""
    wind = gaussian_filter1d(rng.standard_normal((count, 3)), _GUST_S / _KNOT_S / 2, axis=0, mode="wrap")
    return gust_mps * wind / np.maximum(wind.std(axis=0), 1e-9) * [1.0, 1.0, 0.4]


def _fly(wanted: np.ndarray, wind: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(M, 3) positions and (M, 3) yaw, pitch, roll of the simulated body at the knots."""
    model = mujoco.MjModel.from_xml_string(_BODY)
    data = mujoco.MjData(model)
    speed = np.gradient(wanted, _KNOT_S, axis=0)
    push = np.gradient(speed, _KNOT_S, axis=0)
    data.qpos[:3], data.qvel[:3] = wanted[0, :3], speed[0, :3]
    data.qpos[3:] = Rotation.from_euler("z", wanted[0, 3]).as_quat(scalar_first=True)
    poses = np.empty((len(wanted), 7))
    for k in range(len(wanted)):
        poses[k] = data.qpos
        for _ in range(_STEPS_PER_KNOT):
            _control(data, wanted[k], speed[k], push[k], wind[k])
            mujoco.mj_step(model, data)
    turns = Rotation.from_quat(poses[:, 3:], scalar_first=True).as_euler("ZYX")
    yaw = np.unwrap(turns[:, 0])
    return poses[:, :3].copy(), np.column_stack([yaw, -turns[:, 1], turns[:, 2]])


def _control(
    data: mujoco.MjData, wanted: np.ndarray, speed: np.ndarray, push: np.ndarray, wind: np.ndarray
) -> None:
    """Thrust towards the desired point, drag by the wind, torque towards that thrust's attitude."""
    pull = _STIFFNESS * (wanted[:3] - data.qpos[:3]) + _DAMPING * (speed[:3] - data.qvel[:3])
    thrust = push[:3] + pull
    blown = _DRAG * (wind - (data.qvel[:3] - speed[:3]))
    data.xfrc_applied[1, :3] = thrust + blown + [0.0, 0.0, _GRAVITY_MPS2]
    body = Rotation.from_quat(data.qpos[3:], scalar_first=True)
    cos, sin = math.cos(wanted[3]), math.sin(wanted[3])
    ahead, left = cos * thrust[0] + sin * thrust[1], cos * thrust[1] - sin * thrust[0]
    lean = np.clip(np.arctan2([ahead, -left], _GRAVITY_MPS2), -_MOST_LEAN_RAD, _MOST_LEAN_RAD)
    aim = Rotation.from_euler("ZYX", [wanted[3], lean[0], lean[1]])
    off = (aim * body.inv()).as_rotvec()
    spin = body.apply(data.qvel[3:]) - [0.0, 0.0, speed[3]]
    data.xfrc_applied[1, 3:] = _TURN_STIFFNESS * off - _TURN_DAMPING * spin
