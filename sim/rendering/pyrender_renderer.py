"""The renderer on pyrender: the frames of MuJoCo's renderer by independent code.

Over six kinds of world gray levels differ by more than one in .04 % of the pixels, at edges, and within 100 m
depths by more than a millimetre in 6 per million at most (``test_pyrender_renderer.py`` prints it; Mesa's
llvmpipe). It takes one sample per pixel, even if a world requests more: 3.3 % then differ.
"""

import numpy as np

from dslab.sim.rendering.frustum import NEAR_M, Frustum, bounding_balls
from dslab.sim.rendering.pyrender_pass import Pass
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.worlds.base import Surface, WorldModel

# After sim.rendering.pyrender_pass, which prepares the import.
import pyrender  # isort: skip

_CV_FROM_GL = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's camera looks along -z, with y up


class PyrenderRenderer:
    """See ``sim.rendering.renderer.Renderer``."""

    def __init__(self, world: WorldModel, camera: Intrinsics) -> None:
        self._frustum = Frustum.of(camera, world)
        self._centres, self._radii_m = bounding_balls(world.surfaces)
        self._scene = pyrender.Scene(bg_color=np.zeros(4))
        self._nodes = [
            self._scene.add(_mesh(surface, centre, world.faded_texture(index)), pose=_shift(centre))
            for index, (surface, centre) in enumerate(zip(world.surfaces, self._centres, strict=True))
        ]
        numbers = np.arange(1, len(self._nodes) + 1)
        colours = np.stack([numbers & 255, numbers >> 8 & 255, numbers >> 16], -1).astype(float)
        self._colours = dict(zip(self._nodes, colours, strict=True))
        self._eye = self._scene.add(_Pinhole(camera))
        shape = (camera.height_px, camera.width_px)
        self._pass = Pass(self._scene, (camera.width_px, camera.height_px))
        self._gray = np.empty((*shape, 1), np.uint8)
        self._rgb = np.empty((*shape, 3), np.uint8)
        self._zbuffer = np.empty(shape, np.float32)

    def render(self, T_world_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self._look(T_world_cam)
        self._pass.draw(self._scene)
        self._pass.read(self._gray, self._zbuffer)
        zbuffer = self._zbuffer[::-1]
        depth = np.zeros_like(zbuffer)
        np.divide(np.float32(NEAR_M), zbuffer, out=depth, where=zbuffer > 0)
        return self._gray[::-1, :, 0].copy(), depth

    def render_surface_ids(self, T_world_cam: np.ndarray) -> np.ndarray:
        self._look(T_world_cam)
        self._pass.draw(self._scene, self._colours)
        self._pass.read(self._rgb, self._zbuffer)
        red, green, blue = np.moveaxis(self._rgb[::-1].astype(np.int32), -1, 0)
        return (red | green << 8 | blue << 16) - 1

    def close(self) -> None:
        self._pass.delete()

    def _look(self, T_world_cam: np.ndarray) -> None:
        self._scene.set_pose(self._eye, T_world_cam @ _CV_FROM_GL)
        centres = (self._centres - T_world_cam[:3, 3]) @ T_world_cam[:3, :3]
        shown = self._frustum.touches(centres, self._radii_m + 1e-3)
        self._pass.visible = [self._nodes[k] for k in np.flatnonzero(shown).tolist()]


class _Pinhole(pyrender.Camera):
    """Pinhole camera with any intrinsics; depth is 1 on the near plane, 0 at infinity."""

    def __init__(self, camera: Intrinsics) -> None:
        super().__init__(znear=NEAR_M)
        c, width, height = camera, camera.width_px, camera.height_px
        # GL's window edges are half a pixel outside the outermost pixel centres.
        self._projection = np.array(
            [
                [2 * c.fx / width, 0, 1 - (2 * c.cx + 1) / width, 0],
                [0, 2 * c.fy / height, (2 * c.cy + 1) / height - 1, 0],
                [0, 0, 0, NEAR_M],
                [0, 0, -1, 0],
            ]
        )

    def get_projection_matrix(self, width=None, height=None):  # pyright: ignore[reportIncompatibleMethodOverride]
        """(4, 4) float64, eye to clip coordinates; the size is the camera's own."""
        return self._projection


def _mesh(surface: Surface, centre: np.ndarray, texture: np.ndarray) -> pyrender.Mesh:
    """Unlit mesh of the surface about its centre."""
    # pyrender flips images on upload; flipped before, texture rows run along v.
    image = pyrender.Texture(source=texture[::-1], source_channels="R")
    material = pyrender.MetallicRoughnessMaterial(baseColorTexture=image)
    primitive = pyrender.Primitive(
        positions=surface.vertices - centre,
        indices=surface.triangles,
        texcoord_0=surface.uv,
        material=material,
        mode=pyrender.GLTF.TRIANGLES,
    )
    return pyrender.Mesh([primitive])


def _shift(centre: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = centre
    return T
