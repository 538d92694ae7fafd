"""The model of a world: textured surfaces and a route. Metres, z up."""

from dataclasses import dataclass, field

import cv2
import numpy as np


@dataclass(frozen=True)
class Route:
    """A path through free space.

    Attributes:
        centre_m: (M, 2) float64 polyline in x, y, passable on both sides within ``clearance_m``.
        clearance_m: half width of the free space about the polyline.
        closed: the polyline returns to its start.
        height_m: (M,) float64 height of the ground at every point, linear in between; None means 0.
    """

    centre_m: np.ndarray
    clearance_m: float
    closed: bool
    height_m: np.ndarray | None = None


@dataclass(frozen=True)
class Surface:
    """One textured mesh; the unit to which a texture contrast applies.

    Attributes:
        vertices: (V, 3) float64, metres, world frame.
        triangles: (T, 3) int32, counter-clockwise seen from the visible side.
        uv: (V, 2) float64 texture coordinates in [0, 1], v downward in the texture image.
        texture: (h, w) uint8 gray texture, unique to the surface.
        label: readable name, e.g. ``wall 3``.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    uv: np.ndarray
    texture: np.ndarray
    label: str


@dataclass(frozen=True)
class Haze:
    """Haze.

    Attributes:
        extinction_per_m: share of the light lost per metre.
        airlight_level: gray level of the air far away.
    """

    extinction_per_m: float
    airlight_level: float


@dataclass(frozen=True)
class WorldModel:
    """A built world.

    Attributes:
        surfaces: every textured surface.
        mean_level: gray level to which textures fade as their contrast falls.
        contrast: (len(surfaces),) float64 in [0, 1], the texture contrast of each surface.
        haze: None in clear air.
        samples: per pixel of a frame: several for a world with many parts thinner than a pixel, else 1, which
            is faster. Depth and surface ids always have one.
    """

    surfaces: list[Surface]
    mean_level: float
    contrast: np.ndarray = field(default_factory=lambda: np.empty(0))
    haze: Haze | None = None
    samples: int = 1

    def faded_texture(self, index: int) -> np.ndarray:
        """(h, w) uint8: a surface's texture with its contrast about ``mean_level`` multiplied."""
        contrast = float(self.contrast[index]) if len(self.contrast) else 1.0
        levels = self.mean_level + contrast * (np.arange(256) - self.mean_level)
        return cv2.LUT(self.surfaces[index].texture, np.clip(np.rint(levels), 0, 255).astype(np.uint8))
