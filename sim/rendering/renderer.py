"""Interface of renderers: gray frames, depth and surface ids of a world."""

from typing import Protocol

import numpy as np


class Renderer(Protocol):
    """Renders one world through one camera without distortion; a class of (world, camera).

    An empty ``contrast`` of the world means 1 everywhere. Without OpenGL the class raises InputError.
    Implementations release their GL memory in ``close``.
    """

    def render(self, T_world_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One sharp, noise-free frame.

        Args:
            T_world_cam: (4, 4) float64, camera (x right, y down, z forward) to world.

        Returns:
            gray (H, W) uint8 sRGB-encoded; depth (H, W) float32 metres along the optical axis, 0 for no
            surface.
        """
        ...

    def render_surface_ids(self, T_world_cam: np.ndarray) -> np.ndarray:
        """(H, W) int32: index into ``WorldModel.surfaces`` per pixel, -1 for none."""
        ...

    def close(self) -> None:
        """Free the GL resources; the renderer is unusable afterwards."""
        ...
