"""The segments of a spec, one model per kind of degradation."""

from typing import Annotated, Literal

from pydantic import Field

from scenarios.strict import Strict


class SegmentBase(Strict):
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


class LowTexture(SegmentBase):
    """The surfaces that the camera passes in this time have their texture contrast multiplied."""

    kind: Literal["low_texture"]
    contrast: float = Field(
        ge=0, le=1, description="1 leaves the texture, 0 removes it; perceived as log contrast"
    )


class MotionBlur(SegmentBase):
    """The shutter stays open longer: beyond one frame interval it is the blur of averaged frames."""

    kind: Literal["motion_blur"]
    exposure_s: float = Field(ge=0, le=1)


class FastRotation(SegmentBase):
    """The camera swings out and back, a smooth burst of rotation about one of its axes on top of the path."""

    kind: Literal["fast_rotation"]
    rate_degps: float = Field(ge=0, le=1000, description="peak angular rate of the swing")
    axis: Literal["yaw", "pitch", "roll"] = "yaw"


Segment = Annotated[LowTexture | MotionBlur | FastRotation, Field(discriminator="kind")]
