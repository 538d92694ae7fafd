"""Worlds by kind. A new world is one file with ``layout`` and ``build_world`` and one line here."""

from scenarios.worlds import Lamps, Outdoors, World
from sim.worlds.ambience import dimmed, hazed
from sim.worlds.base import Route, WorldModel
from sim.worlds.country import field, motorway
from sim.worlds.indoor import building, corridor, room, warehouse
from sim.worlds.town import city

WORLDS = {
    "room": room,
    "corridor": corridor,
    "building": building,
    "city": city,
    "motorway": motorway,
    "field": field,
    "warehouse": warehouse,
}
"""Modules by kind, each with ``layout`` and ``build_world``."""


def layout(spec: World, seed: int) -> Route:
    """Where a carrier may go in the world; cheap, builds no texture.

    Args:
        spec: the world of a scenario.
        seed: root seed of the sequence.

    Raises:
        InputError: the world's sizes do not fit together.
    """
    return WORLDS[spec.kind].layout(spec, seed)


def build_world(spec: World, seed: int) -> WorldModel:
    """The world with its textures, contrast 1 everywhere; the same seed gives the same bytes.

    Raises:
        InputError: the world's sizes do not fit together.
    """
    world = WORLDS[spec.kind].build_world(spec, seed)
    if isinstance(spec, Lamps):
        world = dimmed(world, spec.lamp_level)
    if isinstance(spec, Outdoors):
        world = hazed(world, spec)
    return world
