"""The cameras of a spec."""

from typing import Any, Literal

from pydantic import Field, model_validator

from dslab.scenarios.lenses import lens_fault
from dslab.scenarios.strict import Strict, with_defaults_of


def _published(width: int, height: int, K: tuple[float, ...], fps: float, **lens: float) -> dict[str, Any]:
    """The fields of a camera with fx, fy, cx and cy in pixels, and radtan distortion if any."""
    size = {"width_px": width, "height_px": height}
    focal = dict(zip(("fx_px", "fy_px", "cx_px", "cy_px"), K, strict=True))
    return {**size, **focal, "fps": fps, **({"distortion": {"model": "radtan", **lens}} if lens else {})}


PRESETS: dict[str, dict[str, Any]] = {
    # Sequences 00 to 02, rectified. Source: calib.txt of the KITTI odometry benchmark.
    "kitti": _published(1241, 376, (718.856, 718.856, 607.1928, 185.2157), 10.0),
    # The lens of 98 degrees, rectified by the data set's own `crop` to 640x480.
    # Source: camera.txt of the TUM monocular visual odometry data set.
    "tum-mono": _published(640, 480, (277.307, 291.357, 312.230, 239.770), 50.0),
    # Left camera of the VI-sensor, as taken. Source: mav0/cam0/sensor.yaml of the EuRoC data set.
    "euroc": _published(
        *(752, 480, (458.654, 457.296, 367.215, 248.375), 20.0),
        k1=-0.28340811,
        k2=0.07395907,
        p1=0.00019359,
        p2=1.76187114e-05,
    ),
    # Left infrared camera of a D435i, rectified by the device.
    # Source: the example calibration that comes with ORB-SLAM3.
    "realsense": _published(640, 480, (382.613, 382.613, 320.183, 236.455), 30.0),
    # iPhone 6s, upright video. Source: calibration of sequences 01 to 12 of the ADVIO data set.
    "phone": _published(
        *(720, 1280, (1077.2, 1079.3, 362.145, 636.3873), 60.0),
        k1=0.0478,
        k2=0.0339,
        p1=-0.00033,
        p2=-0.00091,
    ),
}
"""Published cameras: the fields that they set."""

_OF_MODEL = {"none": (), "radtan": ("k1", "k2", "p1", "p2", "k3"), "equidistant": ("k1", "k2", "k3", "k4")}


class Distortion(Strict):
    """Lens distortion with OpenCV's coefficients: radtan k1 k2 p1 p2 k3, equidistant (fisheye) k1 to k4."""

    model: Literal["none", "radtan", "equidistant"] = "none"
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def coefficients(self) -> tuple[float, ...]:
        """In OpenCV's order; empty without distortion."""
        return tuple(getattr(self, name) for name in _OF_MODEL[self.model])

    @model_validator(mode="after")
    def _of_the_model(self) -> "Distortion":
        names = _OF_MODEL[self.model]
        for name in ("k1", "k2", "k3", "k4", "p1", "p2"):
            if getattr(self, name) and name not in names:
                remedy = f"use {' '.join(names)}" if names else "set model to radtan or equidistant"
                raise ValueError(f"the model {self.model} has no {name}, {remedy}")
        return self


class CalibrationError(Strict):
    """Radial distortion that the frames have and the camera's calibration does not know of.

    An ideal point at radius r, in units of the focal length, lies 1 + k1 r² + k2 r⁴ times as far from the
    principal point.
    """

    k1: float = Field(0.0, ge=-0.2, le=0.2)
    k2: float = Field(0.0, ge=-0.2, le=0.2)


class Camera(Strict):
    """A camera. Integer pixel coordinates are pixel centres, as in OpenCV.

    A frame's stamp is the centre of its exposure, and its true pose is the pose at that moment.
    """

    preset: Literal["kitti", "tum-mono", "euroc", "realsense", "phone"] | None = Field(
        None, description="a published camera; fields given beside it replace its own"
    )
    width_px: int = Field(640, ge=64, le=4096)
    height_px: int = Field(480, ge=64, le=4096)
    fx_px: float = Field(500.0, gt=0)
    fy_px: float = Field(500.0, gt=0)
    cx_px: float = 319.5
    cy_px: float = 239.5
    fps: float = Field(30.0, gt=0, le=1000)
    distortion: Distortion = Distortion()
    exposure_s: float = Field(0.004, ge=0, description="shutter time of the clean frames; blurs them truly")
    noise_sigma: float = Field(
        1.5, ge=0, le=30, description="standard deviation of the pixel noise, grey levels"
    )
    shot_noise: float = Field(
        0.0,
        ge=0,
        le=30,
        description="noise of the light itself at full level, grey levels; as its root below",
    )
    softness_px: float = Field(
        0.0, ge=0, le=5, description="standard deviation of the blur by lens and demosaicing; 0: none"
    )
    contrast: float = Field(
        1.0,
        ge=0.2,
        le=5,
        description="of the tone curve, exponent about its middle; above 1 lights are clipped",
    )
    residual: CalibrationError | None = Field(
        None,
        description="what the calibration leaves of a rectified lens, unknown to the SLAM; none: nothing",
    )

    @model_validator(mode="before")
    @classmethod
    def _start_from_preset(cls, data: Any) -> Any:
        return with_defaults_of(data, "preset", PRESETS)

    @model_validator(mode="after")
    def _possible(self) -> "Camera":
        for name, centre, size in (
            ("cx_px", self.cx_px, self.width_px),
            ("cy_px", self.cy_px, self.height_px),
        ):
            if not 0 <= centre <= size - 1:
                raise ValueError(f"{name} = {centre:g} lies outside the image, use 0 to {size - 1}")
        for name, focal in (("fx_px", self.fx_px), ("fy_px", self.fy_px)):
            if not 0.1 <= focal / self.width_px <= 20:
                low, high = 0.1 * self.width_px, 20 * self.width_px
                raise ValueError(f"{name} = {focal:g} is absurd for this image, use {low:g} to {high:g}")
        if self.residual is not None and self.distortion.model != "none":
            raise ValueError(
                "residual is for rectified cameras, leave it out or set distortion to model: none"
            )
        if fault := self._lens_fault():
            raise ValueError(f"{'residual' if self.residual else 'distortion'}: {fault[0]}, {fault[1]}")
        if self.exposure_s * self.fps > 1:
            raise ValueError(
                f"exposure_s = {self.exposure_s:g} is longer than a frame, use at most {1 / self.fps:.4g}"
            )
        return self

    def _lens_fault(self) -> tuple[str, str] | None:
        """Problem and remedy of a lens that has no ray for some pixel; None for a sound one."""
        model, coefficients = self.distortion.model, self.distortion.coefficients
        if self.residual is not None:
            model, coefficients = "radtan", (self.residual.k1, self.residual.k2, 0.0, 0.0, 0.0)
        if model == "none":
            return None
        return lens_fault(
            (self.width_px, self.height_px),
            (self.fx_px, self.fy_px),
            (self.cx_px, self.cy_px),
            model,
            coefficients,
        )
