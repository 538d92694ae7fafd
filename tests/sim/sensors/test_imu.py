"""Inertial readings: they integrate back to the motion, and their noise has the stated densities."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError
from dslab.scenarios.spec import Trajectory
from dslab.sim.motion.spline import PoseSpline
from dslab.sim.motion.walker import plan_walk
from dslab.sim.sensors.imu import GRAVITY_MPS2, ImuModel, ideal_readings, record_imu
from dslab.sim.worlds.base import Route

ROUTE = Route(np.array([[0.0, 0], [8, 0], [8, 6], [0, 6]]), 1.0, closed=True)
FRAMES_S = np.arange(301) / 30


@pytest.fixture(scope="module")
def walk() -> PoseSpline:
    return plan_walk(ROUTE, Trajectory(), 10.0, seed=4)


def without_noise(model: ImuModel) -> ImuModel:
    return ImuModel(model.rate_hz, 0.0, 0.0, 0.0, 0.0, model.T_cam_imu)


def integrate(gyro, accel, rate_hz, T_world_imu, velocity):
    """(M, 4, 4) poses of the sensor, each step with the mean of its two readings."""
    dt = 1 / rate_hz
    R, p, v = T_world_imu[:3, :3], T_world_imu[:3, 3].copy(), velocity.copy()
    poses = [T_world_imu]
    for k in range(len(gyro) - 1):
        R_next = R @ Rotation.from_rotvec((gyro[k] + gyro[k + 1]) / 2 * dt).as_matrix()
        a = (R @ accel[k] + R_next @ accel[k + 1]) / 2 + GRAVITY_MPS2
        p += v * dt + a * dt * dt / 2
        v += a * dt
        R = R_next
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, p
        poses.append(T)
    return np.array(poses)


def test_perfect_readings_integrate_to_the_trajectory(walk):
    model = without_noise(ImuModel())
    readings, truth = record_imu(walk, FRAMES_S, 0, model)
    true = walk.T_world_cam(readings.stamps_s) @ model.T_cam_imu
    poses = integrate(readings.gyro_radps, readings.accel_mps2, 200, true[0], truth.velocity_mps[0])
    assert len(poses) == 2001 and np.linalg.norm(true[-1, :3, 3] - true[0, :3, 3]) > 1
    assert np.linalg.norm(poses[:, :3, 3] - true[:, :3, 3], axis=1).max() < 0.01
    relative = Rotation.from_matrix(poses[:, :3, :3].transpose(0, 2, 1) @ true[:, :3, :3])
    assert np.rad2deg(relative.magnitude().max()) < 0.05


def test_at_rest_the_accelerometer_points_up_and_the_gyro_is_still():
    knots = np.arange(-2, 4, 0.2)
    turns = np.tile([0.7, 0.2, -0.1], (len(knots), 1))
    still = PoseSpline(knots, np.tile([1.0, 2, 3], (len(knots), 1)), turns)
    T_cam_imu = ImuModel().T_cam_imu
    gyro, accel = ideal_readings(still, np.array([0.0, 1.0]), T_cam_imu)
    R_world_imu = still.T_world_cam(0.0)[:3, :3] @ T_cam_imu[:3, :3]
    np.testing.assert_allclose(gyro, 0, atol=1e-9)
    np.testing.assert_allclose(accel, np.tile(R_world_imu.T @ [0, 0, 9.81], (2, 1)), atol=1e-6)


def test_a_turning_lever_feels_the_centripetal_force():
    knots = np.arange(-2, 4, 0.1)
    rate, lever_m = 1.5, 0.3
    turns = np.column_stack([rate * knots, np.zeros((len(knots), 2))])
    spinning = PoseSpline(knots, np.zeros((len(knots), 3)), turns)
    T_cam_imu = np.eye(4)
    T_cam_imu[2, 3] = lever_m  # ahead of the camera, which turns about its own upright axis
    gyro, accel = ideal_readings(spinning, np.array([0.5]), T_cam_imu)
    np.testing.assert_allclose(gyro, [[0, -rate, 0]], atol=1e-6)
    np.testing.assert_allclose(accel, [[0, -9.81, -(rate**2) * lever_m]], atol=1e-5)


def noise(model: ImuModel, walk: PoseSpline, seed: int, seconds: float = 10.0):
    """Errors of the readings, gyro and accelerometer, (M, 3) each."""
    stamps_s = np.arange(0, seconds + 1e-9, 0.1)
    noisy, _ = record_imu(walk, stamps_s, seed, model)
    ideal, _ = record_imu(walk, stamps_s, seed, without_noise(model))
    return noisy.gyro_radps - ideal.gyro_radps, noisy.accel_mps2 - ideal.accel_mps2


def allan_deviation(error: np.ndarray, cluster: int) -> np.ndarray:
    """(3,) Allan deviation of readings averaged over clusters."""
    means = error[: len(error) // cluster * cluster].reshape(-1, cluster, 3).mean(axis=1)
    return np.sqrt((np.diff(means, axis=0) ** 2).mean(axis=0) / 2)


@pytest.mark.parametrize(("rate_hz", "cluster"), [(100.0, 10), (1000.0, 1)])
def test_white_noise_has_its_density_at_any_rate(walk, rate_hz, cluster):
    model = replace(ImuModel(rate_hz=rate_hz), gyro_walk=0.0, accel_walk=0.0)
    for error, density in zip(noise(model, walk, 1), (model.gyro_noise, model.accel_noise), strict=True):
        # Source: IEEE 952, the Allan deviation of white noise is the density over the root of the time.
        expected = density / np.sqrt(cluster / rate_hz)
        assert np.sqrt((allan_deviation(error, cluster) ** 2).mean()) == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_the_bias_walks_at_its_density_at_any_rate(walk, rate_hz):
    model = replace(ImuModel(rate_hz=rate_hz), gyro_noise=0.0, accel_noise=0.0)
    lag = round(0.1 * rate_hz)
    squares = np.zeros(2)
    for seed in range(4):
        errors = noise(model, walk, seed)
        squares += [((e[lag::lag] - e[:-lag:lag]) ** 2).mean() / 4 for e in errors]
    np.testing.assert_allclose(np.sqrt(squares / 0.1), (model.gyro_walk, model.accel_walk), rtol=0.12)


def test_the_truth_at_the_frames_is_the_bias_and_velocity_of_the_sensor(walk):
    model = replace(ImuModel(), gyro_noise=0.0, accel_noise=0.0)
    readings, truth = record_imu(walk, FRAMES_S, 2, model)
    at = np.rint(FRAMES_S * 200).astype(int)
    ideal = ideal_readings(walk, readings.stamps_s, model.T_cam_imu)
    np.testing.assert_allclose(truth.gyro_bias_radps, (readings.gyro_radps - ideal[0])[at], atol=1e-12)
    np.testing.assert_allclose(truth.accel_bias_mps2, (readings.accel_mps2 - ideal[1])[at], atol=1e-12)
    step_s = 1e-4
    ends = [(walk.T_world_cam(FRAMES_S + s) @ model.T_cam_imu)[:, :3, 3] for s in (step_s, -step_s)]
    np.testing.assert_allclose(truth.velocity_mps, (ends[0] - ends[1]) / (2 * step_s), atol=1e-5)


def test_readings_repeat_with_the_seed_and_differ_without(walk):
    first, again, other = (record_imu(walk, FRAMES_S, seed)[0] for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.gyro_radps, again.gyro_radps)
    np.testing.assert_array_equal(first.accel_mps2, again.accel_mps2)
    assert (first.gyro_radps != other.gyro_radps).all()


@pytest.mark.parametrize(
    ("field", "value"),
    [("rate_hz", 0.0), ("gyro_noise", -1.0), ("accel_walk", float("inf"))],
)
def test_an_impossible_sensor_is_refused_by_name(field, value):
    with pytest.raises(InputError, match=f"imu: {field}"):
        replace(ImuModel(), **{field: value})


def test_a_mounting_that_is_not_rigid_is_refused():
    with pytest.raises(InputError, match="T_cam_imu"):
        ImuModel(T_cam_imu=2 * np.eye(4))
