"""Stairs: flights of steps with their undersides, landings, railings, and the shell around them."""

import numpy as np

from dslab.sim.worlds.geometry.meshes import Mesh, Piece
from dslab.sim.worlds.geometry.panels import Box, Panel, slab, wall
from dslab.sim.worlds.geometry.twins import raised_panel
from dslab.sim.worlds.indoor.building_plan import SLAB_M, Stairwell
from dslab.sim.worlds.materials.stair_finishes import STEP_M

_WAIST_M = 0.17  # of a flight under the inner edge of its steps, upright
_SET_BACK_M = 0.004  # of a slab's edge behind the riser in its plane
_RAIL_M, _RAIL_RADIUS_M, _BAR_RADIUS_M = 0.95, 0.024, 0.011
_RAIL_SHEET_M = (1.2, 1.4)
_PANEL_M, _THIN_M = 2.0, 0.012
_WALL_FINISHES = ("bare plaster", "bare brick", "bare concrete")
_PICTURES = ("poster", "picture", "notice board", "poster", "picture")


def stair_panels(
    well: Stairwell, clear_m: float, rng: np.random.Generator, alike: bool = False
) -> list[Panel]:
    """The flat parts: walls, floors, landings, ceiling, windows and pictures.

    If ``alike``, the same things hang on every storey; ``clear_m`` is from a floor to its ceiling.
    """
    panels = _shell(well, clear_m, rng)
    first = _half_landing(well, 0) + _hangings(well, 0, rng) if alike else []
    for level in range(well.floors):
        panels += _floor_strip(well, level, clear_m)
        if alike and level < well.floors - 1:
            again = [raised_panel(panel, level * well.storey_m, f"again {level}") for panel in first]
            panels += again if level else first
        elif level < well.floors - 1:
            panels += _half_landing(well, level)
            panels += _hangings(well, level, rng)
    return panels


def stair_pieces(well: Stairwell) -> list[Piece]:
    """The flights and railings of every storey."""
    pieces = []
    for level in range(well.floors - 1):
        for upper in (False, True):
            label = f"{well.name} {level}{'b' if upper else 'a'}"
            pieces += _flight(well, level, upper, label)
            pieces.append(_railing(well, level, upper, label))
    pieces.append(_guard(well))
    return pieces


def _shell(well: Stairwell, clear_m: float, rng: np.random.Generator) -> list[Panel]:
    """Three walls, as seen from inside, and the ceiling over the top floor."""
    corners = well.plan(
        np.array([0.0, well.depth_m, well.depth_m, 0.0]), np.array([0.0, 0.0, well.width_m, well.width_m])
    )
    finishes = [str(name) for name in rng.choice(_WALL_FINISHES, 3)]
    panels: list[Panel] = []
    for level in range(well.floors):
        top = level * well.storey_m + (well.storey_m if level < well.floors - 1 else clear_m)
        for side in range(3):
            # Seen from inside, the end of a wall with the greater v or u is on the left.
            label = f"{well.name} wall {level},{side}"
            z = (level * well.storey_m, top)
            panels += wall(corners[side + 1], corners[side], z, finishes[side], label, _PANEL_M)
    low, high = np.sort(corners[[0, 2]], axis=0)
    size = (_PANEL_M, _PANEL_M)
    ceiling = (well.floors - 1) * well.storey_m + clear_m
    panels += slab(low, high, ceiling, False, "ceiling", f"{well.name} ceiling", size)
    ground = np.sort(well.plan(np.array([well.foot_m, well.depth_m]), np.array([0.0, well.width_m])), axis=0)
    return panels + slab(ground[0], ground[1], 0.0, True, "stone", f"{well.name} ground", size)


def _floor_strip(well: Stairwell, level: int, clear_m: float) -> list[Panel]:
    """The floor between the corridor and the flights, with the slab's edge and underside."""
    z = level * well.storey_m
    ends = well.plan(np.array([0.0, well.foot_m]), np.array([0.0, well.width_m]))
    low, high = np.sort(ends, axis=0)
    label, size = f"{well.name} strip {level}", (3.0, 3.0)
    panels = slab(low, high, z, True, "stone", f"{label} top", size)
    if level:
        panels += slab(low, high, z - well.storey_m + clear_m, False, "bare plaster", f"{label} under", size)
        edge = well.plan(well.foot_m - _SET_BACK_M, np.array([well.width_m, 0.0]))
        # Seen from the flights, looking back to the corridor.
        panels += wall(edge[1], edge[0], (z - SLAB_M, z), "bare plaster", f"{label} edge", 4.0)
    return panels


def _half_landing(well: Stairwell, level: int) -> list[Panel]:
    z = (level + 0.5) * well.storey_m
    thick = well.riser_m + _WAIST_M
    ends = well.plan(np.array([well.landing_m, well.depth_m]), np.array([0.0, well.width_m]))
    low, high = np.sort(ends, axis=0)
    label, size = f"{well.name} landing {level}", (3.0, 3.0)
    panels = slab(low, high, z, True, "stone", f"{label} top", size)
    panels += slab(low, high, z - thick, False, "bare plaster", f"{label} under", size)
    edge = well.plan(well.landing_m + _SET_BACK_M, np.array([0.0, well.width_m]))
    return panels + wall(edge[1], edge[0], (z - thick, z), "bare plaster", f"{label} edge", 4.0)


def _hangings(well: Stairwell, level: int, rng: np.random.Generator) -> list[Panel]:
    """A window over the landing, a radiator below it, pictures along the flights."""
    landing = (level + 0.5) * well.storey_m
    middle, half = well.width_m / 2 + rng.uniform(-0.3, 0.3), rng.uniform(0.55, 0.85)
    top = landing + min(2.35, well.storey_m / 2 + 0.85)
    name, foot = f"{well.name} {level}", landing + rng.uniform(0.1, 0.2)
    ends = well.plan(well.depth_m - _THIN_M, np.array([middle + half, middle - half]))
    panels = wall(ends[0], ends[1], (landing + 0.95, top), "window", f"{name} window", np.inf)
    plan = np.sort(well.plan(well.depth_m - np.array([0.09, 0.0]), middle + np.array([-0.5, 0.4])), axis=0)
    back = "east" if well.inward > 0 else "west"
    corners = (np.append(plan[0], foot), np.append(plan[1], foot + 0.6))
    panels += Box(*corners, "radiator", f"{name} radiator", (back,), "frame").panels()
    for side in (0, 1):
        panels += _pictures(well, level, side, rng)
    return panels


def _pictures(well: Stairwell, level: int, side: int, rng: np.random.Generator) -> list[Panel]:
    """Pictures on a side wall that follow the flight beside it."""
    slope, panels = well.riser_m / well.tread_m, []
    v = _THIN_M if side == 0 else well.width_m - _THIN_M
    u = well.foot_m + rng.uniform(0.0, 0.3)
    while True:
        wide, high = rng.uniform(0.35, 0.75), rng.uniform(0.3, 0.7)
        if u + wide > well.depth_m - 0.15:
            return panels
        rise = slope * float(np.clip(u + wide / 2 - well.foot_m, 0, well.landing_m - well.foot_m))
        ground = level * well.storey_m + (rise if side == 0 else well.storey_m - rise)
        foot = ground + rng.uniform(1.15, 1.45)
        ends = well.plan(np.array([u + wide, u] if side == 0 else [u, u + wide]), v)
        label = f"{well.name} picture {level},{side},{u:.2f}"
        finish = str(rng.choice(_PICTURES))
        panels += wall(ends[0], ends[1], (foot, foot + high), finish, label, np.inf)
        u += wide + rng.uniform(0.2, 0.9)


def _lane(well: Stairwell, upper: bool) -> tuple[float, float]:
    """``v`` of a flight's edge at the wall and at the well."""
    return (well.width_m, well.width_m - well.lane_m) if upper else (0.0, well.lane_m)


def _start(well: Stairwell, level: int, upper: bool) -> tuple[float, float, float]:
    """``u`` and z of a flight's lowest riser, and its direction along ``u``."""
    z = level * well.storey_m + (well.storey_m / 2 if upper else 0.0)
    return (well.landing_m, z, -1.0) if upper else (well.foot_m, z, 1.0)


def _flight(well: Stairwell, level: int, upper: bool, label: str) -> list[Piece]:
    """Steps, in one piece, and the flank and underside, in another."""
    u0, z0, way = _start(well, level, upper)
    outer, inner = _lane(well, upper)
    # Seen while climbing, the wall is on the right of the lower flight and of the upper one.
    left, right = inner, outer
    going, rise, count = well.tread_m, well.riser_m, well.steps

    def at(along_m: float, v: float, z: float) -> np.ndarray:
        return np.append(well.plan(u0 + way * along_m, v), z)

    steps, sheet = Mesh(), (well.lane_m, count * STEP_M)
    for j in range(count):
        x, z = j * going, z0 + j * rise
        bottom = sheet[1] - j * STEP_M
        riser = np.array([at(x, left, z + rise), at(x, right, z + rise), at(x, right, z), at(x, left, z)])
        share = rise / (rise + going)
        steps.quad(riser, (0.0, bottom - share * STEP_M), (well.lane_m, share * STEP_M))
        if j == count - 1:
            break
        tread = [at(x + going, left, z + rise), at(x + going, right, z + rise)]
        tread += [at(x, right, z + rise), at(x, left, z + rise)]
        steps.quad(np.array(tread), (0.0, bottom - STEP_M), (well.lane_m, (1 - share) * STEP_M))

    run = (count - 1) * going
    body, size = Mesh(), (run, well.lane_m + rise + _WAIST_M)
    slope = rise / going
    for j in range(count - 1):
        x, z = j * going, z0 + j * rise - _WAIST_M
        flank = [at(x, inner, z + rise + _WAIST_M), at(x + going, inner, z + rise + _WAIST_M)]
        flank += [at(x + going, inner, z + slope * going), at(x, inner, z)]
        # While climbing, the well is on the left; seen from there, the flight climbs to the left.
        seen = [flank[1], flank[0], flank[3], flank[2]]
        body.quad(np.array(seen), (run - x - going, well.lane_m), (going, rise + _WAIST_M))
    low, high = z0 - _WAIST_M, z0 - _WAIST_M + slope * run
    under = [at(0.0, left, low), at(0.0, right, low), at(run, right, high), at(run, left, high)]
    body.quad(np.array(under), (0.0, 0.0), (run, well.lane_m))
    return [
        Piece.of(steps, sheet, "steps", f"{label} steps"),
        Piece.of(body, size, "soffit", f"{label} body"),
    ]


def _railing(well: Stairwell, level: int, upper: bool, label: str) -> Piece:
    """Handrail and bars at the well, and handrail at the wall, of a flight."""
    u0, z0, way = _start(well, level, upper)
    outer, inner = _lane(well, upper)
    aside = 0.03 if upper else -0.03
    run, mesh = (well.steps - 1) * well.tread_m, Mesh()

    def at(along_m: float, v: float, z: float) -> np.ndarray:
        return np.append(well.plan(u0 + way * along_m, v), z)

    low, high = z0 + well.riser_m / 2 + _RAIL_M, z0 + (well.steps - 0.5) * well.riser_m + _RAIL_M
    for v in (inner + aside, outer + (-0.07 if upper else 0.07)):
        _bar(mesh, at(0.0, v, low), at(run, v, high), _RAIL_RADIUS_M, 0)
    turn = at(run, inner + aside, high), at(run, well.width_m / 2, high)
    _bar(mesh, turn[0] if way > 0 else turn[1], turn[1] if way > 0 else turn[0], _RAIL_RADIUS_M, 1)
    for j in range(well.steps - 1):
        foot = z0 + (j + 1) * well.riser_m
        head = low + (j + 0.5) * well.riser_m
        x = (j + 0.5) * well.tread_m
        _bar(mesh, at(x, inner + aside, foot), at(x, inner + aside, head), _BAR_RADIUS_M, 2 + j)
    for x, foot, head in ((0.0, z0, low), (run, z0 + well.steps * well.riser_m, high)):
        _bar(mesh, at(x, inner + aside, foot), at(x, inner + aside, head + 0.05), 0.03, 3)
    return Piece.of(mesh, _RAIL_SHEET_M, "banister", f"{label} railing")


def _guard(well: Stairwell) -> Piece:
    """The railing at the top floor where no further flight begins."""
    mesh, z = Mesh(), (well.floors - 1) * well.storey_m
    u, end = well.foot_m - 0.05, well.width_m - well.lane_m
    rail = [np.append(well.plan(u, v), z + _RAIL_M) for v in (0.0, end)]
    _bar(mesh, rail[0], rail[1], _RAIL_RADIUS_M, 0)
    for k, v in enumerate(np.linspace(0.06, end, 12)):
        place = well.plan(u, float(v))
        _bar(mesh, np.append(place, z), np.append(place, z + _RAIL_M), _BAR_RADIUS_M, 1 + k)
    return Piece.of(mesh, _RAIL_SHEET_M, "banister", f"{well.name} guard")


def _bar(mesh: Mesh, start: np.ndarray, end: np.ndarray, radius_m: float, strip: int) -> None:
    """A round bar with its own strip of the sheet."""
    low = (0.07 * (strip % 16), 0.0)
    mesh.tube(np.array([start, end]), (radius_m, radius_m), 6, low, (0.07, _RAIL_SHEET_M[1]))
