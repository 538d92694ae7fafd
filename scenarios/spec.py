"""The scenario: what happens, as typed and validated data. Nothing is executed here."""

import math
from collections.abc import Sequence
from typing import Any

from pydantic import Field, ValidationError, ValidationInfo, field_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from dslab.scenarios.cameras import Camera
from dslab.scenarios.imu import Imu
from dslab.scenarios.motions import Trajectory
from dslab.scenarios.segments import FastRotation, LowTexture, MotionBlur, Segment, self_overlap
from dslab.scenarios.strict import Strict
from dslab.scenarios.worlds import CorridorWorld, RoomWorld, World

__all__ = [
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


class Scenario(Strict):
    """One scenario; with a seed it is one sequence, bit for bit."""

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
    noise_seed: int | None = Field(
        None, ge=0, lt=2**63, description="likewise, of sensor noise and of what segments draw on images"
    )

    @property
    def frame_count(self) -> int:
        """Frames of the sequence; the first has stamp 0."""
        return max(1, round(self.duration_s * self.camera.fps))

    @property
    def seed_of_world(self) -> int:
        """``world_seed``, else the seed of all."""
        return self.seed if self.world_seed is None else self.world_seed

    @property
    def seed_of_noise(self) -> int:
        """Of sensor noise and image segments: ``noise_seed``, else the seed of all."""
        return self.seed if self.noise_seed is None else self.noise_seed

    @field_validator("segments", mode="before")
    @classmethod
    def _last_to_the_end(cls, segments: Any, info: ValidationInfo) -> Any:
        """Give every segment without a duration the one that ends with the sequence."""
        end_s = info.data.get("duration_s")
        if end_s is None or not isinstance(segments, Sequence):
            return segments
        return [_lasting(segment, end_s) for segment in segments]

    @field_validator("segments")
    @classmethod
    def _segments_fit(cls, segments: tuple[Segment, ...], info: ValidationInfo) -> tuple[Segment, ...]:
        # Without a valid duration there is no end to keep to.
        end_s = info.data.get("duration_s", math.inf)
        faults = {
            index: f"{segment.label}, ends after the sequence, end it by duration_s = {end_s:g}"
            for index, segment in enumerate(segments)
            if segment.end_s > end_s + 1e-9
        }
        clash = self_overlap(segments)
        if clash and clash[1] not in faults:
            first, second = (segments[i].label for i in clash)
            faults[clash[1]] = (
                f"{second}, and segments[{clash[0]}] ({first}) are of one kind and overlap, "
                "start one when the other has ended"
            )
        if faults:
            raise ValidationError.from_exception_data(
                cls.__name__, [_value_error(index, text) for index, text in faults.items()]
            )
        return segments


def _lasting(segment: Any, end_s: float) -> Any:
    if not isinstance(segment, dict) or "duration_s" in segment:
        return segment
    start_s = segment.get("start_s")
    if not isinstance(start_s, int | float):
        return segment
    # One that starts too late is given any duration: it is then found to end too late.
    return {**segment, "duration_s": end_s - start_s if start_s < end_s else 1.0}


def _value_error(index: int, text: str) -> InitErrorDetails:
    kind = PydanticCustomError("value_error", "{error}", {"error": text})
    return InitErrorDetails(type=kind, loc=(index,), input=None)
