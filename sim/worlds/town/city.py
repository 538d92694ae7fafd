"""A city: streets between houses, with pavements, parked cars, trees and lamps, under a sky."""

import numpy as np

from dslab.scenarios.seeds import rng_for
from dslab.scenarios.worlds import CityWorld
from dslab.sim.worlds.assembly import assemble_pieces
from dslab.sim.worlds.base import Route, WorldModel
from dslab.sim.worlds.geometry.meshes import Piece
from dslab.sim.worlds.geometry.outdoor import Daylight, Sky
from dslab.sim.worlds.geometry.route import rounded
from dslab.sim.worlds.geometry.twins import with_twins
from dslab.sim.worlds.town.houses import houses_along, houses_at_end
from dslab.sim.worlds.town.pavements import carriageways, pavements
from dslab.sim.worlds.town.roadside import roadside
from dslab.sim.worlds.town.streets import LANE_M, Plan, plan_streets

_CORNER_RADIUS_M, _CLEARANCE_M = 7.0, 1.2
_SKY_BEYOND_M = 1500.0


def layout(spec: CityWorld, seed: int) -> Route:
    """The right-hand lane along the main streets, its corners rounded.

    Raises:
        InputError: too many turns for the length.
    """
    plan = plan_streets(spec, seed)
    return Route(rounded(_lane(plan), _CORNER_RADIUS_M, plan.closed), _CLEARANCE_M, plan.closed)


def build_world(spec: CityWorld, seed: int) -> WorldModel:
    """The city with its textures.

    Raises:
        InputError: too many turns for the length.
    """
    plan = plan_streets(spec, seed)
    rng = rng_for(seed, "world", "city")
    boxes = [street.box(20.0) for street in plan.streets]
    low, high = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
    light = Daylight(low, high, rng, spec)
    twins = spec.aliased if plan.turned else None
    streets = plan.first_half() if twins else plan.streets
    houses = []
    for street in streets:
        houses += houses_along(plan, street, rng) + houses_at_end(street, rng)
    for house in houses:
        light.shade_polygon(house.footprint(), house.height_m)
    things = [(street, roadside(plan, street, light, rng)) for street in streets]
    pieces: list[Piece] = []
    for street, standing in things:
        # Street by street: neighbours in the list are neighbours in space, so a renderer can cull them.
        pieces += carriageways(plan, street, light) + pavements(plan, street, light)
        pieces += [] if twins else standing
    for house in houses:
        pieces += house.pieces(light)
    if twins:
        movable = [piece for _, standing in things for piece in standing]
        pieces = with_twins(pieces, movable, plan.corners.mean(axis=0), twins, seed)
    reach = float(np.linalg.norm(high - low)) / 2
    pieces += Sky((low + high) / 2, reach + _SKY_BEYOND_M, "meadow", spec).pieces()
    return assemble_pieces(pieces, seed, spec.aliased)


def _lane(plan: Plan) -> np.ndarray:
    """(M, 2) corners of the route, moved from the street's middle into the right lane."""
    corners = plan.corners
    closed = np.vstack([corners[-1:], corners, corners[:1]]) if plan.closed else corners
    ways = np.diff(closed, axis=0)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    right = np.column_stack([ways[:, 1], -ways[:, 0]])
    if plan.closed:
        return corners + LANE_M * (right[:-1] + right[1:])
    return corners + LANE_M * np.vstack([right[:1], right[:-1] + right[1:], right[-1:]])
