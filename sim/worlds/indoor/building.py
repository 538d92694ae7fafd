"""A building of several floors: branching corridors, rooms, two staircases."""

from dataclasses import dataclass, replace

import numpy as np

from dslab.scenarios.seeds import rng_for
from dslab.scenarios.worlds import BuildingWorld
from dslab.sim.worlds.assembly import Lighting, assemble_panels, assemble_pieces
from dslab.sim.worlds.base import Route, WorldModel
from dslab.sim.worlds.geometry.atlas import gathered
from dslab.sim.worlds.geometry.panels import Panel
from dslab.sim.worlds.geometry.route import arc_length
from dslab.sim.worlds.geometry.twins import turned_panel
from dslab.sim.worlds.indoor.building_light import Lamplight, stair_light
from dslab.sim.worlds.indoor.building_plan import Plan, clearance_m, route_nodes, walked_floors
from dslab.sim.worlds.indoor.interior import storey_panels
from dslab.sim.worlds.indoor.stairs import stair_panels, stair_pieces
from dslab.sim.worlds.indoor.storey import plan_storey

_EYE_M = 1.5
_GROWTH_M = 0.0015
_FINEST, _FINEST_AT_M = 0.7, 1.0  # texture detail of panels at one metre from the eye, and its fall beyond
_CELL_M, _SMALL_PX = (4.0, 4.0), 70_000  # cells of the plan in which small surfaces are joined
_SEEN_BELOW_M = 1.0  # from the stairs, eyes slightly below a floor see it


def layout(spec: BuildingWorld, seed: int) -> Route:
    """Route up the stairs; for a loop, up one staircase and down the other.

    It is the same for every seed. The origin is the south-western corner of the ring of corridors, on the
    ground floor.
    """
    del seed
    centre, height = route_nodes(spec)
    return Route(centre, clearance_m(), spec.loop, height)


def build_world(spec: BuildingWorld, seed: int) -> WorldModel:
    """The building with its textures; the floors differ in plan, finishes and furniture."""
    plan, eyes = Plan.of(spec), _eyes(spec)
    stairwells = stair_light(plan)
    twins = spec.twins
    panels: list[Panel] = []
    lights: dict[str, tuple[Lighting, float]] = {}
    ground: list[tuple[list[Panel], Lighting]] = []
    for level in range(spec.floors):
        base = level * spec.storey_m
        rng = rng_for(seed, "world", "building", "storey", level)
        if twins and ground and level in walked_floors(spec):
            groups = _storey_again(ground, plan, level, spec.loop)
        else:
            storey = plan_storey(plan, level in walked_floors(spec), rng)
            groups = storey_panels(storey, plan.clear_m, plan.reach_m(), rng)
            ground = ground or groups
        for own, light in groups:
            raised = [_raised(panel, base, f"floor {level} {panel.label}") for panel in own]
            lights |= {panel.label: (light, base) for panel in raised}
            panels += raised
    if twins:
        west = stair_panels(
            plan.stairs[0], plan.clear_m, rng_for(seed, "world", "building", "stairs"), alike=True
        )
        panels += [*west, *(turned_panel(panel, plan.ring / 2) for panel in west)]
    else:
        for stairs in plan.stairs:
            panels += stair_panels(stairs, plan.clear_m, rng_for(seed, "world", "building", stairs.name))
    distance_m = np.array(
        [_distance(panel, _eyes_with_sight_of(panel, lights, eyes, spec)) for panel in panels]
    )
    seen = np.flatnonzero(np.isfinite(distance_m))
    detail = np.minimum(_FINEST, _FINEST_AT_M / np.maximum(distance_m[seen], 1e-6))
    flat = assemble_panels(
        [_grown(panels[k]) for k in seen], _BuildingLight(lights, stairwells), seed, detail, spec.aliased
    )
    pieces = [piece for stairs in plan.stairs for piece in stair_pieces(stairs)]
    lit = [replace(piece, gain=stairwells.piece_gain(piece)) for piece in pieces]
    shaped = assemble_pieces(lit, seed, spec.aliased)
    surfaces = gathered([*flat.surfaces, *shaped.surfaces], (*_CELL_M, spec.storey_m), _SMALL_PX)
    return WorldModel(surfaces, flat.mean_level, np.ones(len(surfaces)))


def _storey_again(
    ground: list[tuple[list[Panel], Lighting]], plan: Plan, level: int, loop: bool
) -> list[tuple[list[Panel], Lighting]]:
    """The ground floor as another floor, turned so that the route passes the same things there."""
    centre = plan.ring / 2
    if not loop and level % 2 == 0:
        return [([replace(p, twin=f"floor 0 {p.label}") for p in own], light) for own, light in ground]
    return [
        (
            [replace(turned_panel(p, centre), label=p.label, twin=f"floor 0 {p.label}") for p in own],
            _TurnedLight(light, centre),
        )
        for own, light in ground
    ]


@dataclass(frozen=True)
class _TurnedLight:
    """A light after half a turn about ``centre`` (2,)."""

    light: Lighting
    centre: np.ndarray

    def gain(self, panel: Panel) -> np.ndarray:
        """As of ``Light``."""
        return self.light.gain(turned_panel(panel, self.centre))


@dataclass(frozen=True)
class _BuildingLight:
    """The light of corridors and rooms, by the labels of their panels.

    Lights come with the height of their floor. All other panels are in the stairwells.
    """

    rooms: dict[str, tuple[Lighting, float]]
    stairs: Lamplight

    def gain(self, panel: Panel) -> np.ndarray:
        """As of ``Light``."""
        if panel.label not in self.rooms:
            return self.stairs.gain(panel)
        light, base_m = self.rooms[panel.label]
        return light.gain(_raised(panel, -base_m, panel.label))


def _raised(panel: Panel, by_m: float, label: str) -> Panel:
    return replace(panel, corner=panel.corner + np.array([0.0, 0.0, by_m]), label=label)


def _grown(panel: Panel) -> Panel:
    """The panel slightly enlarged, against visible cracks between neighbours."""
    corner = panel.corner - _GROWTH_M * (panel.right + panel.down)
    size = {"width_m": panel.width_m + 2 * _GROWTH_M, "height_m": panel.height_m + 2 * _GROWTH_M}
    return replace(panel, corner=corner, **size)


def _eyes_with_sight_of(
    panel: Panel, lights: dict[str, tuple[Lighting, float]], eyes: np.ndarray, spec: BuildingWorld
) -> np.ndarray:
    """Eye positions that a panel's floor does not hide; stairwells are open to all."""
    if panel.label not in lights:
        return eyes
    above = eyes[:, 2] - lights[panel.label][1]
    return eyes[(above > -_SEEN_BELOW_M) & (above < spec.storey_m)]


def _eyes(spec: BuildingWorld) -> np.ndarray:
    """(E, 3) eye positions along the route, half a metre apart in plan."""
    centre, height = route_nodes(spec)
    arc = arc_length(centre)
    at = np.arange(0.0, arc[-1], 0.5)
    line = np.column_stack([centre, height + _EYE_M])
    return np.column_stack([np.interp(at, arc, column) for column in line.T])


def _distance(panel: Panel, eyes: np.ndarray) -> float:
    """Metres to the nearest eye position that can see the panel's face; infinite if none."""
    before = eyes[(eyes - panel.corner) @ panel.normal > 0]
    if not len(before):
        return np.inf
    off = before - panel.corner
    u = np.clip(off @ panel.right, 0.0, panel.width_m)
    v = np.clip(off @ panel.down, 0.0, panel.height_m)
    nearest = panel.corner + u[:, None] * panel.right + v[:, None] * panel.down
    return float(np.linalg.norm(before - nearest, axis=1).min())
