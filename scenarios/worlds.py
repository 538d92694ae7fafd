"""The worlds of a spec, one model per kind."""

from typing import Annotated, Literal

from pydantic import Field

from scenarios.strict import Strict


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
