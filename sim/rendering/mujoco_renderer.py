"""The renderer on MuJoCo's OpenGL pipeline: unlit textured meshes, depth, surface ids.

A pixel shows its texture's level: materials emit their texture and there are no lights, so light and shade
are part of the textures and fade with their contrast.
"""

import ctypes
from collections.abc import Iterator
from ctypes import c_uint, c_void_p
from itertools import product

import cv2
import numpy as np

from dslab.scenarios.errors import InputError
from dslab.sim.rendering.frustum import Frustum, bounding_balls
from dslab.sim.rendering.gl_context import gl_info, shared_context
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.worlds.base import Surface, WorldModel

# MuJoCo's import must come after sim.rendering.gl_context's, which tells it to load no GL library.
import mujoco  # isort: skip

MOST_SURFACES = 900  # one context of MuJoCo takes fewer than 1000 materials and textures
_ID_BASE = np.array([1, 1 << 8, 1 << 16], np.int32)
_GL_PROJECTION_MATRIX = 0x0BA7
_DRAWN, _HIDDEN = int(mujoco.mjtGeom.mjGEOM_MESH), int(mujoco.mjtGeom.mjGEOM_NONE)


class MujocoRenderer:
    """See ``sim.rendering.renderer.Renderer``."""

    def __init__(self, world: WorldModel, camera: Intrinsics) -> None:
        self._shape = (camera.height_px, camera.width_px)
        self._frustum = Frustum.of(camera, world)
        self._context = shared_context()
        self._context.make_current()
        starts = range(0, len(world.surfaces), MOST_SURFACES)
        self._parts = [_Part(world, start, camera, self._frustum) for start in starts]
        # Multisampled depth is useless, and parts would show seams: multisampling uses one part of the whole.
        smooth = world.samples > 1 and len(self._parts) == 1
        self._smooth = [_Part(world, 0, camera, self._frustum, world.samples)] if smooth else []
        self._rgb = np.empty((*self._shape, 3), np.uint8)
        self._zbuffer = np.empty(self._shape, np.float32)
        self._bias, self._offset_m = self._projection_row()

    def render(self, T_world_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        gray, zbuffer = np.zeros(self._shape, np.uint8), np.zeros(self._shape, np.float32)
        for _ in self._draw_parts(self._parts, T_world_cam, ids=False):
            nearer = self._zbuffer[::-1] > zbuffer
            np.copyto(gray, self._rgb[::-1, :, 0], where=nearer)
            np.copyto(zbuffer, self._zbuffer[::-1], where=nearer)
        for _ in self._draw_parts(self._smooth, T_world_cam, ids=False):
            gray = self._rgb[::-1, :, 0].copy()
        depth_m = np.zeros_like(zbuffer)
        return gray, np.divide(self._offset_m, zbuffer + self._bias, out=depth_m, where=zbuffer != 0)

    def render_surface_ids(self, T_world_cam: np.ndarray) -> np.ndarray:
        surfaces, zbuffer = np.full(self._shape, -1, np.int32), np.zeros(self._shape, np.float32)
        for part in self._draw_parts(self._parts, T_world_cam, ids=True):
            rgb, part_zbuffer = self._rgb[::-1], self._zbuffer[::-1]
            nearer = part_zbuffer > zbuffer
            levels = rgb.astype(np.int32)
            np.copyto(surfaces, part.start + levels @ _ID_BASE - 1, where=nearer)
            np.copyto(zbuffer, part_zbuffer, where=nearer)
        return surfaces

    def close(self) -> None:
        self._context.make_current()
        for part in (*self._parts, *self._smooth):
            part.free()

    def _draw_parts(self, parts: list["_Part"], T_world_cam: np.ndarray, ids: bool) -> Iterator["_Part"]:
        """Draw and read each part in sight; its buffers hold until the next part."""
        self._context.make_current()
        for part in parts:
            if part.in_sight(T_world_cam, self._frustum):
                part.draw(T_world_cam, ids)
                part.read(self._rgb, self._zbuffer)
                yield part

    def _projection_row(self) -> tuple[np.float32, np.float32]:
        """Bias and offset of the projection: zbuffer = offset_m / Z - bias.

        MuJoCo computes its reversed projection in single precision. Computed again from the planes, the bias
        would differ by 6e-8, which is a metre of depth at a kilometre.
        """
        self._context.make_current()
        self._parts[0].draw(np.eye(4), ids=False)
        get_floats = ctypes.CFUNCTYPE(None, c_uint, c_void_p)(self._context.address("glGetFloatv"))
        matrix = np.zeros(16, np.float32)
        get_floats(_GL_PROJECTION_MATRIX, matrix.ctypes.data)
        bias, offset_m = matrix[10], matrix[14]
        near, far = self._frustum.near_m, self._frustum.far_m
        if abs(bias - near / (far - near)) > 1e-6:
            raise InputError("GL", f"{gl_info()['renderer']} has no reversed depth", "use Mesa 22 or newer")
        return bias, offset_m


class _Part:
    """Surfaces that fit one MuJoCo context, with their model and offscreen buffer."""

    def __init__(
        self, world: WorldModel, start: int, camera: Intrinsics, frustum: Frustum, samples: int = 1
    ) -> None:
        self.start = start
        surfaces = world.surfaces[start : start + MOST_SURFACES]
        textures = [world.faded_texture(start + k) for k in range(len(surfaces))]
        low = np.min([s.vertices.min(axis=0) for s in surfaces], axis=0)
        high = np.max([s.vertices.max(axis=0) for s in surfaces], axis=0)
        self._box = np.array(list(product(*zip(low, high, strict=True))))
        self._centres, self._radii_m = bounding_balls(surfaces)
        self._frustum = frustum
        self._shown = np.ones(len(surfaces), bool)
        model = _model(surfaces, textures, camera, samples)
        self._viewport = mujoco.MjrRect(0, 0, camera.width_px, camera.height_px)
        self._scene = _static_scene(model, frustum)
        self._geoms = list(self._scene.geoms)
        self._mjr = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        self._mjr.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR

    def in_sight(self, T_world_cam: np.ndarray, frustum: Frustum) -> bool:
        """False only if no surface can be seen."""
        return not frustum.misses((self._box - T_world_cam[:3, 3]) @ T_world_cam[:3, :3])

    def draw(self, T_world_cam: np.ndarray, ids: bool) -> None:
        """Draw colours, or surface numbers from 1 as colours, into the part's buffer."""
        for eye in self._scene.camera:
            eye.pos = T_world_cam[:3, 3]
            eye.forward, eye.up = T_world_cam[:3, 2], -T_world_cam[:3, 1]
        self._hide_invisible(T_world_cam)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = ids
        self._scene.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = ids
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._mjr)
        mujoco.mjr_render(self._viewport, self._scene, self._mjr)

    def _hide_invisible(self, T_world_cam: np.ndarray) -> None:
        """Hide geoms outside the view: MuJoCo draws every geom that has a type."""
        centres = (self._centres - T_world_cam[:3, 3]) @ T_world_cam[:3, :3]
        shown = self._frustum.touches(centres, self._radii_m + 1e-3)
        for index in np.flatnonzero(shown != self._shown).tolist():
            self._geoms[index].type = _DRAWN if shown[index] else _HIDDEN
        self._shown = shown

    def read(self, rgb: np.ndarray, zbuffer: np.ndarray) -> None:
        """Read what was drawn, the lowest row first."""
        mujoco.mjr_readPixels(rgb, zbuffer, self._viewport, self._mjr)

    def free(self) -> None:
        self._mjr.free()


def _model(
    surfaces: list[Surface], textures: list[np.ndarray], camera: Intrinsics, samples: int
) -> mujoco.MjModel:
    """One static geom per surface, in their order."""
    spec = mujoco.MjSpec()
    spec.visual.quality.offsamples = samples if samples > 1 else 0
    spec.visual.quality.shadowsize = 0
    spec.visual.global_.offwidth, spec.visual.global_.offheight = camera.width_px, camera.height_px
    spec.visual.headlight.active = 0
    for index, (surface, texture) in enumerate(zip(surfaces, textures, strict=True)):
        _add_surface(spec, str(index), surface, texture)
    return spec.compile()


def _add_surface(spec: mujoco.MjSpec, name: str, surface: Surface, texture: np.ndarray) -> None:
    height, width = texture.shape
    added = spec.add_texture(
        name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=width, height=height, nchannel=3
    )
    added.data = cv2.cvtColor(texture, cv2.COLOR_GRAY2RGB).tobytes()
    material = spec.add_material(name=name, emission=1.0, specular=0.0, shininess=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    faces = surface.triangles.astype(np.int32).reshape(-1)
    spec.add_mesh(
        name=name,
        uservert=surface.vertices.astype(np.float32).reshape(-1),
        userface=faces,
        usertexcoord=surface.uv.astype(np.float32).reshape(-1),
        userfacetexcoord=faces,
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, material=name, contype=0, conaffinity=0
    )


def _static_scene(model: mujoco.MjModel, frustum: Frustum) -> mujoco.MjvScene:
    """Scene of every geom; only the camera pose changes from frame to frame."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    scene = mujoco.MjvScene(model, maxgeom=model.ngeom)
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), mujoco.mjtCatBit.mjCAT_ALL, scene
    )
    scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
    scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
    near = frustum.near_m
    for eye in scene.camera:
        eye.frustum_center = near * (frustum.left + frustum.right) / 2
        eye.frustum_width = near * (frustum.right - frustum.left) / 2
        eye.frustum_top, eye.frustum_bottom = near * frustum.top, near * frustum.bottom
        eye.frustum_near, eye.frustum_far = near, frustum.far_m
    return scene
