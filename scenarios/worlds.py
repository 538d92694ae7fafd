"""The worlds of a spec, one model per kind."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

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


class CityWorld(Strict):
    """Streets between houses; the route keeps to the right-hand lane. The first street leads along +x."""

    kind: Literal["city"] = "city"
    length_m: float = Field(400.0, ge=80, le=2000, description="of the route, once round for a loop")
    loop: bool = Field(False, description="the route goes round a block, again and again")
    turns: int = Field(2, ge=0, le=20, description="right-angled corners of an open route")

    @model_validator(mode="after")
    def _a_loop_has_a_block(self) -> "CityWorld":
        if self.loop and self.length_m < 280:
            raise ValueError(f"a loop of {self.length_m:g} m leaves no block, use length_m of at least 280")
        return self


class MotorwayWorld(Strict):
    """A motorway with gentle bends and little to see; the route keeps to a right-hand lane."""

    kind: Literal["motorway"] = "motorway"
    length_m: float = Field(800.0, ge=200, le=2000)


class FieldWorld(Strict):
    """Open grassland with bushes, single trees and a fence; the route is a ring about the origin."""

    kind: Literal["field"] = "field"
    size_m: float = Field(80.0, ge=40, le=300, description="side of the square that the ring keeps to")


class WarehouseWorld(Strict):
    """Tall racks in rows; the route goes up and down the aisles and back, round and round."""

    kind: Literal["warehouse"] = "warehouse"
    length_m: float = Field(30.0, ge=12, le=120, description="of the racks")
    aisles: Literal[2, 4, 6, 8] = 4
    height_m: float = Field(7.0, ge=4, le=15)


World = Annotated[
    RoomWorld | CorridorWorld | CityWorld | MotorwayWorld | FieldWorld | WarehouseWorld,
    Field(discriminator="kind"),
]
