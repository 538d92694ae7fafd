"""The view frustum of a pinhole camera, for the renderers."""

from dataclasses import dataclass

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.worlds.base import Surface, WorldModel

NEAR_M = 0.05


@dataclass(frozen=True)
class Frustum:
    """View frustum: slopes of its sides per metre of depth, and its depth range."""

    left: float
    right: float
    top: float
    bottom: float
    near_m: float
    far_m: float

    @classmethod
    def of(cls, c: Intrinsics, world: WorldModel) -> "Frustum":
        """Frustum of a camera in a world; GL's edges are half a pixel outside the outermost centres.

        Raises:
            InputError: the camera has distortion.
        """
        if any(c.distortion):
            raise InputError("camera: distortion", "the renderer has no lens distortion", "set it to zero")
        return cls(
            left=(-0.5 - c.cx) / c.fx,
            right=(c.width_px - 0.5 - c.cx) / c.fx,
            top=(0.5 + c.cy) / c.fy,
            bottom=(0.5 + c.cy - c.height_px) / c.fy,
            near_m=NEAR_M,
            far_m=far_plane(world),
        )

    def misses(self, corners: np.ndarray) -> bool:
        """Return True if a convex body (n, 3), camera frame, lies wholly outside one side."""
        x, y, z = corners.T
        sides = (
            x - self.right * z,
            self.left * z - x,
            -y - self.top * z,
            self.bottom * z + y,
            self.near_m - z,
        )
        return any(bool((side > 0).all()) for side in sides)

    def touches(self, centres: np.ndarray, radii_m: np.ndarray) -> np.ndarray:
        """(n,) bool, False only for balls wholly outside one side; centres (n, 3), camera frame."""
        x, y, z = centres.T
        inside = z + radii_m > self.near_m
        # A side through the eye has the unit normal (1, -slope) / length in its plane.
        for across, slope in ((x, self.right), (-x, -self.left), (-y, self.top), (y, -self.bottom)):
            inside &= across - slope * z < radii_m * np.hypot(1.0, slope)
        return inside


def far_plane(world: WorldModel) -> float:
    """A distance beyond anything visible from inside the world, metres."""
    low = np.min([s.vertices.min(axis=0) for s in world.surfaces], axis=0)
    high = np.max([s.vertices.max(axis=0) for s in world.surfaces], axis=0)
    return float(np.linalg.norm(high - low) + 10.0)


def bounding_balls(surfaces: list[Surface]) -> tuple[np.ndarray, np.ndarray]:
    """Centres (n, 3) and radii (n,) of balls that hold one surface each, metres, for ``Frustum.touches``."""
    centres = np.array([(s.vertices.min(axis=0) + s.vertices.max(axis=0)) / 2 for s in surfaces])
    reach = [np.linalg.norm(s.vertices - c, axis=1).max() for s, c in zip(surfaces, centres, strict=True)]
    return centres, np.array(reach)
