"""Rendering through a lens with distortion."""

from collections.abc import Callable

import numpy as np

from dslab.sim.rendering.renderer import Renderer
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.distortion import Lens


class DistortingRenderer:
    """A renderer through a lens; see ``sim.rendering.renderer.Renderer``.

    Args:
        renderer_factory: makes the renderer of the ideal camera.
        camera: with distortion.

    Raises:
        InputError: as ``Lens``.
    """

    def __init__(self, renderer_factory: Callable[[Intrinsics], Renderer], camera: Intrinsics) -> None:
        self._lens = Lens(camera)
        self._inner = renderer_factory(self._lens.ideal)

    @property
    def gl_renderer(self) -> str:
        """The GL implementation's own name."""
        return self._inner.gl_renderer

    def render(self, T_world_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Render a frame: gray (H, W) uint8, depth (H, W) float32 metres, 0 for none."""
        gray, depth_m = self._inner.render(T_world_cam)
        return self._lens.distort(gray), self._lens.distort_depth(depth_m)

    def render_surface_ids(self, T_world_cam: np.ndarray) -> np.ndarray:
        """(H, W) int32: index into ``WorldModel.surfaces`` per pixel, -1 for none."""
        return self._lens.distort_labels(self._inner.render_surface_ids(T_world_cam))

    def close(self) -> None:
        """Free the GL resources; the renderer is unusable afterwards."""
        self._inner.close()


def lens_renderer(renderer_factory: Callable[[Intrinsics], Renderer], camera: Intrinsics) -> Renderer:
    """Return the factory's renderer for a pinhole camera, else one through the lens."""
    return renderer_factory(camera) if camera.is_pinhole else DistortingRenderer(renderer_factory, camera)
