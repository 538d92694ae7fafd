"""The motions of a spec."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, Field, WithJsonSchema, model_validator
from pydantic_core import PydanticCustomError

from dslab.scenarios.strict import Strict, with_defaults_of

KINDS: dict[str, dict[str, float]] = {
    "walk": {},
    "handheld": {
        "max_speed_mps": 1.4,
        "max_rate_degps": 60.0,
        "sway_m": 0.035,
        "shake_deg": 0.5,
        "step_hz": 1.8,
    },
    "car": {
        "max_speed_mps": 10.0,
        "max_rate_degps": 35.0,
        "eye_height_m": 1.65,
        "sway_m": 0.015,
        "shake_deg": 0.25,
        "max_accel_mps2": 2.5,
    },
    "drone": {
        "max_speed_mps": 4.0,
        "max_rate_degps": 60.0,
        "eye_height_m": 2.5,
        "sway_m": 0.0,
        "max_accel_mps2": 2.0,
        "gust_mps": 2.0,
    },
}
"""Fields that each kind of motion sets."""

_OF_KIND: dict[str, tuple[str, ...]] = {
    "walk": (),
    "handheld": ("shake_deg", "step_hz", "look_deg"),
    "car": ("shake_deg", "max_accel_mps2"),
    "drone": ("max_accel_mps2", "gust_mps"),
}


_OWN_FIELDS = ("shake_deg", "step_hz", "max_accel_mps2", "gust_mps", "look_deg")


def add_motion_kind(kind: str, defaults: Mapping[str, float], fields: tuple[str, ...] = ()) -> None:
    """Make a kind of motion known to scenarios; ``sim.register_motion`` also says how it moves.

    Args:
        kind: its name.
        defaults: fields of the trajectory that the kind sets.
        fields: those of shake_deg, step_hz, max_accel_mps2, gust_mps and look_deg that the kind has.

    Raises:
        ValueError: the kind is taken, or a field is unknown.
    """
    if kind in KINDS:
        raise ValueError(f"there is a motion of kind {kind!r} already: name yours differently")
    unknown = [name for name in defaults if name not in Trajectory.model_fields or name == "kind"]
    unknown += [name for name in fields if name not in _OWN_FIELDS]
    if unknown:
        raise ValueError(f"a trajectory has no field {unknown[0]!r}")
    KINDS[kind] = dict(defaults)
    _OF_KIND[kind] = fields


def _known_kind(kind: str) -> str:
    if kind not in KINDS:
        expected = " or ".join(filter(None, (", ".join(map(repr, [*KINDS][:-1])), repr([*KINDS][-1]))))
        raise PydanticCustomError("literal_error", "Input should be {expected}", {"expected": expected})
    return kind


class _MotionKinds(WithJsonSchema):
    """The JSON Schema of the kinds known at the time of asking."""

    def __init__(self) -> None:
        super().__init__({})

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        return {"type": "string", "enum": [*KINDS]}


MotionKind = Annotated[str, AfterValidator(_known_kind), _MotionKinds()]


class Trajectory(Strict):
    """A smooth path along the world's route.

    ``gaze`` is where the camera looks relative to the direction of travel: 0 ahead, 90 to the left wall.
    """

    kind: MotionKind = Field("walk", description="kind of motion; it sets the defaults of the other fields")
    max_speed_mps: float = Field(0.9, gt=0, le=60)
    max_rate_degps: float = Field(40.0, gt=0, le=400)
    gaze_deg: float = Field(0.0, ge=-180, le=180)
    eye_height_m: float = Field(1.5, gt=0, le=15)
    sway_m: float = Field(
        0.04, ge=0, le=2, description="amplitude of the sway; of a car's heave, of a step's bob"
    )
    shake_deg: float = Field(
        0.0, ge=0, le=5, description="amplitude of the quick turns: hands and steps, a car's springs"
    )
    step_hz: float = Field(0.0, ge=0, le=4, description="steps per second of the person who holds the camera")
    max_accel_mps2: float = Field(0.0, ge=0, le=30, description="along the path and across it")
    gust_mps: float = Field(0.0, ge=0, le=15, description="standard deviation of the wind about a drone")
    look_deg: float = Field(
        0.0,
        ge=0,
        le=45,
        description="amplitude of looking about; up, down and askew three quarters of it",
    )

    @model_validator(mode="before")
    @classmethod
    def _start_from_kind(cls, data: Any) -> Any:
        return with_defaults_of(data, "kind", KINDS)

    @model_validator(mode="after")
    def _of_the_kind(self) -> "Trajectory":
        own = _OF_KIND[self.kind]
        for name in _OWN_FIELDS:
            if getattr(self, name) and name not in own:
                kinds = ", ".join(kind for kind, names in _OF_KIND.items() if name in names)
                raise ValueError(f"a {self.kind} has no {name}, set kind to one of: {kinds}")
        if "max_accel_mps2" in own and not self.max_accel_mps2:
            raise ValueError(f"a {self.kind} without acceleration cannot move, set max_accel_mps2 above 0")
        return self
