"""Worlds by kind. A new world is one file with ``layout`` and ``build_world`` and one line here."""

from scenarios.spec import CorridorWorld, RoomWorld
from sim.world import corridor, room
from sim.world.base import Route, WorldModel

_WORLDS = {"room": room, "corridor": corridor}


def layout(spec: RoomWorld | CorridorWorld, seed: int) -> Route:
    """Where a carrier may go in the world; cheap, builds no texture.

    Args:
        spec: the world of a scenario.
        seed: root seed of the sequence.

    Raises:
        InputError: the world's sizes do not fit together.
    """
    return _WORLDS[spec.kind].layout(spec, seed)


def build_world(spec: RoomWorld | CorridorWorld, seed: int) -> WorldModel:
    """The world with its textures, contrast 1 everywhere; the same seed gives the same bytes.

    Raises:
        InputError: the world's sizes do not fit together.
    """
    return _WORLDS[spec.kind].build_world(spec, seed)
