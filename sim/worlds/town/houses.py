"""Houses along streets: a front at the pavement, a body with a pitched roof behind."""

from dataclasses import dataclass

import numpy as np

from dslab.sim.worlds.geometry.meshes import Mesh, Piece
from dslab.sim.worlds.geometry.outdoor import Daylight
from dslab.sim.worlds.town.streets import FRONT_M, Plan, Street

_WIDTH_M, _HEIGHT_M, _DEPTH_M, _RIDGE_M = (8.0, 15.0), (8.5, 18.0), 9.0, (1.0, 3.2)
_INSET_M = 0.15  # bodies keep clear of the fronts around a corner
_FRONTS = ("plaster front", "plaster front", "brick front", "stone front")
_LIGHT_CELL_M = 0.8


@dataclass(frozen=True)
class House:
    """One house.

    Attributes:
        left, right: (2,) float64 ends of its front as seen from the street, metres.
        height_m: of the eaves.
        ridge_m: height of the ridge above the eaves.
        finish: of the front.
        detail: of the front's texture.
        label: readable name, unique in the world.
    """

    left: np.ndarray
    right: np.ndarray
    height_m: float
    ridge_m: float
    finish: str
    detail: float
    label: str

    @property
    def along(self) -> np.ndarray:
        """(2,) unit vector along the front, to the right as seen."""
        return (self.right - self.left) / np.linalg.norm(self.right - self.left)

    @property
    def outward(self) -> np.ndarray:
        """(2,) unit vector from the front to the street."""
        return np.array([self.along[1], -self.along[0]])

    def footprint(self) -> np.ndarray:
        """(4, 2) corners of the plan."""
        back = -_DEPTH_M * self.outward
        return np.array([self.left, self.right, self.right + back, self.left + back])

    def pieces(self, light: Daylight) -> list[Piece]:
        """Its front and its body."""
        wide = float(np.linalg.norm(self.right - self.left))
        front = Mesh()
        plan = np.array([self.left, self.right, self.right, self.left])
        z = np.array([self.height_m, self.height_m, 0.0, 0.0])
        front.quad(np.column_stack([plan, z]), (0.0, 0.0), (wide, self.height_m))
        lit = self._front_light(light, wide)
        size = (wide, self.height_m)
        return [
            Piece.of(front, size, self.finish, self.label, lit, self.detail),
            self._body(light, wide),
        ]

    def _front_light(self, light: Daylight, wide: float) -> np.ndarray:
        columns, rows = (max(2, round(side / _LIGHT_CELL_M)) for side in (wide, self.height_m))
        u, v = (np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows
        plan = self.left + (u[None, :, None] * wide) * self.along
        height = np.broadcast_to((self.height_m * (1 - v))[:, None, None], (rows, columns, 1))
        points = np.concatenate([np.broadcast_to(plan, (rows, columns, 2)), height], axis=-1)
        return light.gain(points, np.append(self.outward, 0.0))

    def _body(self, light: Daylight, wide: float) -> Piece:
        """Blind sides and roof; the sheet holds the roof in its upper quarter."""
        out, along = np.append(self.outward, 0.0), np.append(self.along, 0.0)
        left = np.append(self.left, 0.0) - 0.02 * out + _INSET_M * along
        right = np.append(self.right, 0.0) - 0.02 * out - _INSET_M * along
        back, eaves = -_DEPTH_M * out, np.array([0.0, 0.0, self.height_m])
        ridge = eaves + [0, 0, self.ridge_m] + back / 2
        tall = self.height_m + self.ridge_m
        sheet = (max(wide, _DEPTH_M), tall * 4 / 3)
        roof_high = sheet[1] / 4
        mesh = Mesh()
        slope = (0.0, 0.0), (wide, roof_high)
        mesh.quad(np.array([left + ridge, right + ridge, right + eaves, left + eaves]), *slope)
        mesh.quad(np.array([right + ridge, left + ridge, left + back + eaves, right + back + eaves]), *slope)
        for near, far, top in ((right, right + back, ridge + right), (left + back, left, ridge + left)):
            # Seen from outside: near corner on the left, pointed gable above.
            vertices = np.array([near + eaves, top, far + eaves, far, near])
            u = np.array([0.0, 0.5, 1.0, 1.0, 0.0]) * _DEPTH_M
            v = roof_high + tall - vertices[:, 2]
            mesh.add(vertices, np.array([[0, 2, 1], [0, 4, 3], [0, 3, 2]]), np.column_stack([u, v]))
        rear = np.array([right + back + eaves, left + back + eaves, left + back, right + back])
        mesh.quad(rear, (0.0, roof_high + self.ridge_m), (wide, self.height_m))
        gain = light.gain(np.zeros((2, 2, 3)) + ridge + left + [0, 0, 30.0], out)
        return Piece.of(mesh, sheet, "gable", f"{self.label} body", gain)


def houses_along(plan: Plan, street: Street, rng: np.random.Generator) -> list[House]:
    """Rows of houses on both sides, side by side wherever no street passes."""
    rank = plan.streets.index(street)
    houses = []
    for side in (1.0, -1.0):
        for low, high in plan.free(street, side * (FRONT_M + 1.0), FRONT_M):
            for start, end in _lots(low, high, rng):
                ends = [street.point(at, side * FRONT_M) for at in (start, end)]
                left, right = ends if side > 0 else ends[::-1]
                houses.append(_house(left, right, street, f"house {rank},{len(houses)}", rng))
    return houses


def houses_at_end(street: Street, rng: np.random.Generator) -> list[House]:
    """The house that closes the view along a street, at each dead end."""
    name = f"{street.start[0]:.0f},{street.start[1]:.0f} {street.end[0]:.0f},{street.end[1]:.0f}"
    ends = [street.point(street.length_m, side * FRONT_M) for side in (1.0, -1.0)]
    houses = [_house(ends[0], ends[1], street, f"end house {name}", rng)]
    if not street.joined:
        starts = [street.point(0.0, side * FRONT_M) for side in (-1.0, 1.0)]
        houses.append(_house(starts[0], starts[1], street, f"start house {name}", rng))
    return houses


def _lots(low: float, high: float, rng: np.random.Generator) -> list[tuple[float, float]]:
    count = max(1, round((high - low) / rng.uniform(*_WIDTH_M)))
    shares = np.cumsum(rng.uniform(0.75, 1.25, count))
    edges = low + (high - low) * np.append(0.0, shares / shares[-1])
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _house(
    left: np.ndarray, right: np.ndarray, street: Street, label: str, rng: np.random.Generator
) -> House:
    height, ridge = rng.uniform(*_HEIGHT_M), rng.uniform(*_RIDGE_M)
    finish = _FRONTS[rng.integers(len(_FRONTS))]
    return House(left, right, height, ridge, finish, 1.0 if street.main else 0.55, label)
