"""The scenario: what happens, as typed and validated data. Nothing is executed here."""

from typing import Literal

from pydantic import Field, model_validator

from scenarios.cameras import Camera
from scenarios.imu import Imu
from scenarios.motions import Trajectory
from scenarios.segments import FastRotation, LowTexture, MotionBlur, Segment, self_overlap
from scenarios.strict import Strict
from scenarios.worlds import CorridorWorld, RoomWorld, World

__all__ = [
    "SPEC_VERSION",
    "Camera",
    "CorridorWorld",
    "FastRotation",
    "Imu",
    "LowTexture",
    "MotionBlur",
    "RoomWorld",
    "Scenario",
    "Segment",
    "Strict",
    "Trajectory",
    "World",
]

SPEC_VERSION = 1


class Scenario(Strict):
    """One scenario; with a seed it is one sequence, bit for bit."""

    spec_version: Literal[1] = SPEC_VERSION
    name: str = Field(pattern=r"^[a-z0-9][a-z0-9_/-]*$", max_length=80)
    description: str = ""
    duration_s: float = Field(30.0, gt=0, le=3600)
    world: World
    trajectory: Trajectory = Trajectory()
    camera: Camera = Camera()
    imu: Imu | None = Field(None, description="inertial readings, for the forms that have a place for them")
    segments: tuple[Segment, ...] = ()
    seed: int = Field(0, ge=0, lt=2**63)
    world_seed: int | None = Field(
        None, ge=0, lt=2**63, description="seed of the world where it is another than that of all else"
    )

    @property
    def frame_count(self) -> int:
        """Frames of the sequence; the first has stamp 0."""
        return max(1, round(self.duration_s * self.camera.fps))

    @model_validator(mode="after")
    def _segments_fit(self) -> "Scenario":
        for index, segment in enumerate(self.segments):
            if segment.end_s > self.duration_s + 1e-9:
                raise ValueError(
                    f"segments[{index}] ({segment.label}) ends after the sequence, "
                    f"end it by duration_s = {self.duration_s:g}"
                )
        clash = self_overlap(self.segments)
        if clash:
            first, second = (f"segments[{i}] ({self.segments[i].label})" for i in clash)
            raise ValueError(
                f"{first} and {second} are of one kind and overlap, start one when the other has ended"
            )
        return self
