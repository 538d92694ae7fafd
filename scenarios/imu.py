"""The inertial sensor of a spec."""

from typing import Any, Literal

from pydantic import Field, model_validator

from dslab.scenarios.strict import Strict, with_defaults_of

_FIELDS = ("rate_hz", "gyro_noise", "gyro_walk", "accel_noise", "accel_walk")
PRESETS: dict[str, dict[str, float]] = {
    name: dict(zip(_FIELDS, values, strict=True))
    for name, values in {
        # ADIS16448 of the VI-sensor. Source: mav0/imu0/sensor.yaml of the EuRoC data set.
        "euroc": (200.0, 1.6968e-4, 1.9393e-5, 2.0e-3, 3.0e-3),
        # BMI160. Source: imu_config.yaml of the TUM VI data set.
        "tum-vi": (200.0, 1.6e-4, 2.2e-5, 2.8e-3, 8.6e-4),
        # BMI055 of a D435i. Source: the example calibration that comes with ORB-SLAM3.
        "realsense": (200.0, 1e-3, 1e-6, 1e-2, 1e-4),
        "perfect": (200.0, 0.0, 0.0, 0.0, 0.0),
    }.items()
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
