"""Inertial sensor at the camera: gyro and accelerometer readings of the true motion.

Readings are the true angular rate and specific force at their stamps, plus white noise, plus a random-walk
bias. Source: Furgale, Rehder, Siegwart, "Unified temporal and spatial calibration for
multi-sensor systems", IROS 2013, and the noise model of the calibration tools built on it.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError
from dslab.scenarios.imu import Imu
from dslab.scenarios.seeds import rng_for
from dslab.sim.motion.base import Motion

GRAVITY_MPS2 = np.array([0.0, 0.0, -9.81])
"""World frame, z up."""

# Half the span of the difference quotient of velocities: its error, the third derivative of the velocity
# times the square of this over 6, is below 1e-6 m/s^2, and so is the rounding error.
_STEP_S = 1e-4


def _vi_sensor_mounting() -> np.ndarray:
    """T_cam_imu of the EuRoC VI-sensor's left camera. Source: sensor.yaml of the EuRoC data set."""
    T_imu_cam = np.eye(4)
    T_imu_cam[:3] = [
        [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975],
        [0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768],
        [-0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949],
    ]
    # The printed digits give a rotation only to 1e-12.
    T_imu_cam[:3, :3] = Rotation.from_matrix(T_imu_cam[:3, :3]).as_matrix()
    return np.linalg.inv(T_imu_cam)


@dataclass(frozen=True)
class ImuModel:
    """Rate, noise and mounting of an inertial sensor; the defaults are those of EuRoC's ADIS16448.

    Attributes:
        rate_hz: readings per second.
        gyro_noise: white noise of the gyro, rad/s/sqrt(Hz).
        gyro_walk: random walk of its bias, rad/s^2/sqrt(Hz).
        accel_noise: white noise of the accelerometer, m/s^2/sqrt(Hz).
        accel_walk: random walk of its bias, m/s^3/sqrt(Hz).
        T_cam_imu: (4, 4) sensor to camera.

    Raises:
        InputError: a field is impossible (the line names it).
    """

    rate_hz: float = 200.0
    gyro_noise: float = 1.6968e-4
    gyro_walk: float = 1.9393e-5
    accel_noise: float = 2.0e-3
    accel_walk: float = 3.0e-3
    T_cam_imu: np.ndarray = field(default_factory=_vi_sensor_mounting)

    def __post_init__(self) -> None:
        """Check every field."""
        if not 1 <= self.rate_hz <= 10_000:
            raise InputError("imu: rate_hz", f"{self.rate_hz:g} is no rate", "use 1 to 10000")
        for name in ("gyro_noise", "gyro_walk", "accel_noise", "accel_walk"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"imu: {name}", f"{value:g} is no density", "give a number of at least 0")
        T = np.asarray(self.T_cam_imu)
        if T.shape != (4, 4) or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-6):
            raise InputError("imu: T_cam_imu", "is no rigid transform", "give a rotation and a translation")

    @classmethod
    def of_spec(cls, imu: Imu) -> "ImuModel":
        """The sensor of a scenario."""
        return cls(**imu.model_dump(exclude={"preset"}))


@dataclass(frozen=True)
class ImuReadings:
    """Readings of the sensor.

    Attributes:
        model: the sensor.
        stamps_s: (M,) sequence time.
        gyro_radps: (M, 3) angular rate, sensor frame.
        accel_mps2: (M, 3) specific force, sensor frame: at rest it points up.
    """

    model: ImuModel
    stamps_s: np.ndarray
    gyro_radps: np.ndarray
    accel_mps2: np.ndarray


@dataclass(frozen=True)
class ImuTruth:
    """The sensor's true state at the frames' stamps.

    Attributes:
        velocity_mps: (N, 3) of the sensor, world frame.
        gyro_bias_radps: (N, 3).
        accel_bias_mps2: (N, 3).
    """

    velocity_mps: np.ndarray
    gyro_bias_radps: np.ndarray
    accel_bias_mps2: np.ndarray


def record_imu(
    motion: Motion, frame_stamps_s: np.ndarray, seed: int, model: ImuModel | None = None
) -> tuple[ImuReadings, ImuTruth]:
    """Record readings from the first frame to the last, with the truth at the frames.

    Args:
        motion: of the camera; defined slightly beyond both ends.
        frame_stamps_s: (N,) stamps of the frames.
        seed: root seed; the streams are ``("imu", ...)``.
        model: the sensor; None for the defaults.
    """
    model = model or ImuModel()
    first, last = (round(float(t) * model.rate_hz) for t in frame_stamps_s[[0, -1]])
    stamps_s = np.arange(first, last + 1) / model.rate_hz
    gyro, accel = ideal_readings(motion, stamps_s, model.T_cam_imu)
    gyro_bias = _walk(len(stamps_s), model.gyro_walk, model.rate_hz, seed, "gyro")
    accel_bias = _walk(len(stamps_s), model.accel_walk, model.rate_hz, seed, "accel")
    readings = ImuReadings(
        model,
        stamps_s,
        gyro + gyro_bias + _white(gyro.shape, model.gyro_noise, model.rate_hz, seed, "gyro"),
        accel + accel_bias + _white(accel.shape, model.accel_noise, model.rate_hz, seed, "accel"),
    )
    nearest = np.clip(np.rint(frame_stamps_s * model.rate_hz).astype(int) - first, 0, len(stamps_s) - 1)
    velocity = _velocity(motion, frame_stamps_s, model.T_cam_imu)
    return readings, ImuTruth(velocity, gyro_bias[nearest], accel_bias[nearest])


def ideal_readings(
    motion: Motion, stamps_s: np.ndarray, T_cam_imu: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Angular rate and specific force of a perfect sensor.

    Args:
        motion: of the camera.
        stamps_s: (M,) stamps.
        T_cam_imu: (4, 4) sensor to camera.

    Returns:
        (M, 3) rad/s and (M, 3) m/s^2, sensor frame.
    """
    R_world_imu = motion.T_world_cam(stamps_s)[:, :3, :3] @ T_cam_imu[:3, :3]
    later, earlier = (_velocity(motion, stamps_s + step, T_cam_imu) for step in (_STEP_S, -_STEP_S))
    force = (later - earlier) / (2 * _STEP_S) - GRAVITY_MPS2
    return motion.rate_radps(stamps_s) @ T_cam_imu[:3, :3], np.einsum("mij,mi->mj", R_world_imu, force)


def _velocity(motion: Motion, stamps_s: np.ndarray, T_cam_imu: np.ndarray) -> np.ndarray:
    """(M, 3) velocity of the sensor, world frame, including the lever arm's rotation."""
    R_world_cam = motion.T_world_cam(stamps_s)[:, :3, :3]
    lever = np.cross(motion.rate_radps(stamps_s), T_cam_imu[:3, 3])
    return motion.velocity_mps(stamps_s) + np.einsum("mij,mj->mi", R_world_cam, lever)


def _white(shape: tuple[int, ...], density: float, rate_hz: float, seed: int, name: str) -> np.ndarray:
    """White noise of readings; as interval means, it grows with the rate's root."""
    return density * np.sqrt(rate_hz) * rng_for(seed, "imu", name, "white").standard_normal(shape)


def _walk(count: int, density: float, rate_hz: float, seed: int, name: str) -> np.ndarray:
    """(count, 3) bias, 0 at the first reading."""
    steps = rng_for(seed, "imu", name, "walk").standard_normal((count, 3)) * density / np.sqrt(rate_hz)
    steps[0] = 0
    return np.cumsum(steps, axis=0)
