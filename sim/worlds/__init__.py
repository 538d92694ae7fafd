"""Worlds by kind."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, Protocol

from dslab.scenarios.extensions import note_extension
from dslab.scenarios.worlds import WORLD_KINDS, Lamps, Outdoors, World, WorldBase
from dslab.sim.worlds.ambience import dimmed, hazed
from dslab.sim.worlds.base import Route, WorldModel
from dslab.sim.worlds.country import field, motorway
from dslab.sim.worlds.indoor import building, corridor, room, warehouse
from dslab.sim.worlds.town import city


class WorldMaker(Protocol):
    """A kind of world: a route through it, and itself. The same spec and seed must give the same bytes."""

    @property
    def layout(self) -> Callable[[Any, int], Route]: ...
    @property
    def build_world(self) -> Callable[[Any, int], WorldModel]: ...


WORLDS: dict[str, WorldMaker] = {
    "room": room,
    "corridor": corridor,
    "building": building,
    "city": city,
    "motorway": motorway,
    "field": field,
    "warehouse": warehouse,
}
"""Makers by kind: modules with ``layout`` and ``build_world``, and what was registered."""


def layout(spec: World, seed: int) -> Route:
    """Route through a world; cheap, builds no texture.

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


def register_world(
    model: type[WorldBase],
    layout: Callable[[Any, int], Route],
    build_world: Callable[[Any, int], WorldModel],
) -> None:
    """Add a kind of world, to be named as ``world: {kind: ...}`` in scenarios.

    Args:
        model: its fields in a scenario, with ``kind: Literal["name"]``; derived from ``scenarios.Lamps`` or
            ``scenarios.Outdoors`` it gets their light and haze.
        layout: gives the route through the world from the validated fields and a seed; cheap.
        build_world: gives the textured surfaces, likewise.

    Raises:
        ValueError: the model has no literal kind, or the kind is taken.
    """
    kind = WORLD_KINDS.add(model)
    WORLDS[kind] = SimpleNamespace(layout=layout, build_world=build_world)
    note_extension(f"world: {kind}", build_world)
