"""The scenario: what happens, as typed and validated data. Nothing is executed here."""

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

SPEC_VERSION = 1


class Strict(BaseModel):
    """Base of every part of a spec: frozen, unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class RoomWorld(Strict):
    """A furnished rectangular room, origin at the centre of its floor, z up."""

    kind: Literal["room"] = "room"
    length_m: float = Field(14.0, ge=4, le=100)
    width_m: float = Field(10.0, ge=4, le=100)
    height_m: float = Field(3.2, ge=2.2, le=20)


class CorridorWorld(Strict):
    """A corridor with right-angled turns; its floor is at z = 0 and it starts at the origin along +x."""

    kind: Literal["corridor"] = "corridor"
    length_m: float = Field(60.0, ge=8, le=2000)
    width_m: float = Field(2.4, ge=1.4, le=20)
    height_m: float = Field(2.8, ge=2.2, le=20)
    turns: int = Field(2, ge=0, le=50)


World = Annotated[RoomWorld | CorridorWorld, Field(discriminator="kind")]


class Trajectory(Strict):
    """A smooth carrier path along the world's route.

    ``gaze`` is where the camera looks relative to the direction of travel: 0 ahead, 90 to the left wall.
    """

    max_speed_mps: float = Field(0.9, gt=0, le=60)
    max_rate_degps: float = Field(40.0, gt=0, le=400)
    gaze_deg: float = Field(0.0, ge=-180, le=180)
    eye_height_m: float = Field(1.5, gt=0, le=15)
    sway_m: float = Field(0.04, ge=0, le=2, description="amplitude of the smooth sideways and vertical sway")


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


class _Segment(Strict):
    start_s: float = Field(ge=0)
    duration_s: float = Field(gt=0)

    @property
    def end_s(self) -> float:
        """End of the segment, sequence time."""
        return self.start_s + self.duration_s

    @property
    def severity(self) -> dict[str, float | str]:
        """The parameters that say how bad it is, without kind and times."""
        return self.model_dump(exclude={"kind", "start_s", "duration_s"})


class LowTexture(_Segment):
    """The surfaces that the camera passes in this time have their texture contrast multiplied."""

    kind: Literal["low_texture"]
    contrast: float = Field(
        ge=0, le=1, description="1 leaves the texture, 0 removes it; perceived as log contrast"
    )


class MotionBlur(_Segment):
    """The shutter stays open longer: beyond one frame interval it is the blur of averaged frames."""

    kind: Literal["motion_blur"]
    exposure_s: float = Field(ge=0, le=1)


class FastRotation(_Segment):
    """The camera swings out and back, a smooth burst of rotation about one of its axes on top of the path."""

    kind: Literal["fast_rotation"]
    rate_degps: float = Field(ge=0, le=1000, description="peak angular rate of the swing")
    axis: Literal["yaw", "pitch", "roll"] = "yaw"


Segment = Annotated[LowTexture | MotionBlur | FastRotation, Field(discriminator="kind")]


class Scenario(Strict):
    """One scenario; with a seed it is one sequence, bit for bit."""

    spec_version: Literal[1] = SPEC_VERSION
    name: str = Field(pattern=r"^[a-z0-9][a-z0-9_/-]*$", max_length=80)
    description: str = ""
    duration_s: float = Field(30.0, gt=0, le=3600)
    world: World
    trajectory: Trajectory = Trajectory()
    camera: Camera = Camera()
    segments: tuple[Segment, ...] = ()
    seed: int = Field(0, ge=0, lt=2**63)

    @property
    def frame_count(self) -> int:
        """Frames of the sequence; the first has stamp 0."""
        return max(1, round(self.duration_s * self.camera.fps))

    @model_validator(mode="after")
    def _segments_fit(self) -> "Scenario":
        for index, segment in enumerate(self.segments):
            if segment.end_s > self.duration_s + 1e-9:
                raise ValueError(
                    f"segments[{index}] ({segment.kind}, {_span(segment)}) ends after the sequence, "
                    f"end it by duration_s = {self.duration_s:g}"
                )
        in_time = sorted(enumerate(self.segments), key=lambda item: item[1].start_s)
        for (i, first), (j, second) in pairwise(in_time):
            if second.start_s < first.end_s - 1e-9:
                raise ValueError(
                    f"segments[{i}] ({first.kind}, {_span(first)}) and segments[{j}] ({second.kind}, "
                    f"{_span(second)}) overlap, start one when the other has ended"
                )
        return self


def _span(segment: _Segment) -> str:
    return f"{segment.start_s:g}-{segment.end_s:g} s"
