"""The inertial sensor of a spec."""

from typing import Any, Literal

from pydantic import Field, model_validator

from dslab.scenarios.strict import Strict, with_defaults_of

PRESETS: dict[str, dict[str, float]] = {
    # ADIS16448 of the VI-sensor. Source: mav0/imu0/sensor.yaml of the EuRoC data set.
    "euroc": {
        "rate_hz": 200.0,
        "gyro_noise": 1.6968e-4,
        "gyro_walk": 1.9393e-5,
        "accel_noise": 2.0e-3,
        "accel_walk": 3.0e-3,
    },
    # BMI160. Source: imu_config.yaml of the TUM VI data set.
    "tum-vi": {
        "rate_hz": 200.0,
        "gyro_noise": 1.6e-4,
        "gyro_walk": 2.2e-5,
        "accel_noise": 2.8e-3,
        "accel_walk": 8.6e-4,
    },
    # BMI055 of a D435i. Source: the example calibration that comes with ORB-SLAM3.
    "realsense": {
        "rate_hz": 200.0,
        "gyro_noise": 1e-3,
        "gyro_walk": 1e-6,
        "accel_noise": 1e-2,
        "accel_walk": 1e-4,
    },
    "perfect": {
        "rate_hz": 200.0,
        "gyro_noise": 0.0,
        "gyro_walk": 0.0,
        "accel_noise": 0.0,
        "accel_walk": 0.0,
    },
}
"""Published sensors, and one without noise: the fields that they set."""


class Imu(Strict):
    """Gyro and accelerometer beside the camera, mounted as in EuRoC's VI-sensor."""

    preset: Literal["euroc", "tum-vi", "realsense", "perfect"] | None = Field(
        "euroc", description="a published sensor; fields given beside it replace its own"
    )
    rate_hz: float = Field(200.0, ge=1, le=10_000)
    gyro_noise: float = Field(1.6968e-4, ge=0, description="white noise, rad/s/sqrt(Hz)")
    gyro_walk: float = Field(1.9393e-5, ge=0, description="random walk of the bias, rad/s^2/sqrt(Hz)")
    accel_noise: float = Field(2.0e-3, ge=0, description="white noise, m/s^2/sqrt(Hz)")
    accel_walk: float = Field(3.0e-3, ge=0, description="random walk of the bias, m/s^3/sqrt(Hz)")

    @model_validator(mode="before")
    @classmethod
    def _start_from_preset(cls, data: Any) -> Any:
        return with_defaults_of(data, "preset", PRESETS)
