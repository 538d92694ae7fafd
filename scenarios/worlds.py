"""The worlds of a spec, one model per kind."""

from typing import TYPE_CHECKING, Annotated, Literal, get_args

from pydantic import Field, model_validator

from dslab.scenarios.kinds import Kinds
from dslab.scenarios.strict import Strict


class WorldBase(Strict):
    """Base of the models of worlds; each has a literal ``kind``."""


class Lamps(WorldBase):
    """Light under a roof. The camera's exposure stays what it was: where it is dim, its frames are dark."""

    lamp_level: float = Field(1.0, ge=0.05, le=1.6, description="light of all lamps, relative to the usual")


class Outdoors(WorldBase):
    """Light and air under the sky."""

    sky: Literal["clear", "overcast"] = Field("clear", description="overcast: no sun and no cast shadows")
    sun_elevation_deg: float | None = Field(
        None, ge=8, le=85, description="above the horizon; none: drawn from the seed, 40 to 58"
    )
    sun_azimuth_deg: float | None = Field(
        None, ge=-360, le=360, description="from +x towards +y; none: drawn from the seed"
    )
    haze_m: float | None = Field(
        None, ge=20, le=100_000, description="visibility, where 2 % of the contrast is left; none: clear air"
    )


class Aliasing(Strict):
    """Things and whole places that occur again elsewhere in the world, and look the same there."""

    things: float = Field(
        0.4, ge=0, le=1, description="share of the surfaces that show what a few others show too"
    )
    scaled: float = Field(
        0.3,
        ge=0,
        le=1,
        description="share of those that show it larger or smaller, or on a thing of another kind",
    )
    places: float = Field(
        0.8,
        ge=0,
        le=1,
        description="share of one half of the world that is found in the other too; 0: the halves differ",
    )


class Aliased(WorldBase):
    """A world that can repeat itself."""

    aliased: Aliasing | None = Field(None, description="what occurs again; none: every surface is unique")

    @property
    def twins(self) -> Aliasing | None:
        """How alike the halves of the world are; None if they differ."""
        return self.aliased if self.aliased and self.aliased.places else None


Surfaces = Annotated[
    Literal["worn", "clean"],
    Field(description="worn: texture everywhere; clean: smooth ones beside prints, fine tiles and stripes"),
]


class RoomWorld(Lamps, Aliased):
    """A furnished rectangular room, origin at the centre of its floor, z up."""

    kind: Literal["room"] = "room"
    length_m: float = Field(14.0, ge=4, le=100)
    width_m: float = Field(10.0, ge=4, le=100)
    height_m: float = Field(3.2, ge=2.2, le=20)
    surfaces: Surfaces = "worn"


class CorridorWorld(Lamps, Aliased):
    """A corridor with right-angled turns; its floor is at z = 0 and it starts at the origin along +x."""

    kind: Literal["corridor"] = "corridor"
    length_m: float = Field(60.0, ge=8, le=2000)
    width_m: float = Field(2.4, ge=1.4, le=20)
    height_m: float = Field(2.8, ge=2.2, le=20)
    turns: int = Field(2, ge=0, le=50, description="right-angled, of an open corridor")
    loop: bool = Field(False, description="four legs round a block, again and again")
    surfaces: Surfaces = "worn"


class CityWorld(Outdoors, Aliased):
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


class MotorwayWorld(Outdoors, Aliased):
    """A motorway with gentle bends, few things beside it; the route keeps to a right-hand lane."""

    kind: Literal["motorway"] = "motorway"
    length_m: float = Field(800.0, ge=200, le=2000, description="of the route, once round for a ring")
    loop: bool = Field(False, description="the road is a ring, driven again and again")

    @model_validator(mode="after")
    def _a_ring_is_wide(self) -> "MotorwayWorld":
        if self.loop and self.length_m < 480:
            raise ValueError(f"a ring of {self.length_m:g} m is too narrow, use length_m of at least 480")
        return self


class FieldWorld(Outdoors, Aliased):
    """Hilly pasture with trees, hedges, bales and barns; the route is a level ring about the origin."""

    kind: Literal["field"] = "field"
    size_m: float = Field(80.0, ge=40, le=300, description="side of the square that the ring keeps to")


class WarehouseWorld(Lamps, Aliased):
    """Tall racks in rows; the route goes up and down the aisles and back, round and round."""

    kind: Literal["warehouse"] = "warehouse"
    length_m: float = Field(30.0, ge=12, le=120, description="of the racks")
    aisles: Literal[2, 4, 6, 8] = 4
    height_m: float = Field(7.0, ge=4, le=15)


class BuildingWorld(Lamps, Aliased):
    """Floors with a ring of corridors, side corridors and open rooms; stairs at both ends of the ring."""

    kind: Literal["building"] = "building"
    floors: int = Field(3, ge=2, le=6)
    length_m: float = Field(24.0, ge=18, le=80, description="of the ring of corridors")
    width_m: float = Field(2.2, ge=1.8, le=4, description="of the corridors")
    storey_m: float = Field(3.2, ge=2.8, le=4.5, description="from floor to floor")
    loop: bool = Field(
        False, description="up one staircase to the top, along, down the other and back, again and again"
    )


_Known = RoomWorld | CorridorWorld | BuildingWorld | CityWorld | MotorwayWorld | FieldWorld | WarehouseWorld
WORLD_KINDS: Kinds[WorldBase] = Kinds("world", get_args(_Known))
"""The model of every kind of world, by kind; ``sim.register_world`` adds one."""

if TYPE_CHECKING:
    World = _Known
else:
    World = Annotated[WorldBase, WORLD_KINDS]
