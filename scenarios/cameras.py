"""The cameras of a spec."""

from pydantic import Field, model_validator

from scenarios.strict import Strict


class Camera(Strict):
    """A pinhole camera. Integer pixel coordinates are pixel centres, as in OpenCV.

    A frame's stamp is the centre of its exposure, and its true pose is the pose at that moment.
    """

    width_px: int = Field(640, ge=64, le=4096)
    height_px: int = Field(480, ge=64, le=4096)
    fx_px: float = Field(500.0, gt=0)
    fy_px: float = Field(500.0, gt=0)
    cx_px: float = 319.5
    cy_px: float = 239.5
    fps: float = Field(30.0, gt=0, le=1000)
    exposure_s: float = Field(0.004, ge=0, description="shutter time of the clean frames; blurs them truly")
    noise_sigma: float = Field(
        1.5, ge=0, le=30, description="standard deviation of the pixel noise, grey levels"
    )

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
        if self.exposure_s * self.fps > 1:
            raise ValueError(
                f"exposure_s = {self.exposure_s:g} is longer than a frame, use at most {1 / self.fps:.4g}"
            )
        return self
