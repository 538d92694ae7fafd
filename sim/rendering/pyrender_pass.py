"""pyrender's renderer, drawing one sample per pixel into a reversed depth buffer of floats.

pyrender itself draws four samples with 24 bits of depth: its depth belongs to a point beside the pixel's
centre and is coarse beyond some ten metres. Here the scene is static, so that work which pyrender repeats
in each frame is done once.
"""

import ctypes
import os
import sys
from collections.abc import Callable
from types import ModuleType

import numpy as np
import OpenGL
from OpenGL.plugins import FormatHandler, PlatformPlugin

from dslab.scenarios.errors import InputError
from dslab.sim.rendering.gl_context import PYRENDER, GlContext, shared_context

_PLATFORM = "dslab"
_GL_LOWER_LEFT, _GL_ZERO_TO_ONE = 0x8CA1, 0x935F  # arguments of glClipControl


def _prepare_imports() -> None:
    """Set the state of the process that PyOpenGL and pyrender read on import."""
    shared_context(PYRENDER).make_current()
    PlatformPlugin(_PLATFORM, "dslab.sim.rendering.pyopengl_platform.ContextPlatform")
    os.environ["PYOPENGL_PLATFORM"] = _PLATFORM
    # pyrender pins PyOpenGL 3.1.0, which knows the type of ctypes.byref by its name before Python 3.12.
    reference = type(ctypes.byref(ctypes.c_int()))
    handler = "OpenGL.arrays.ctypesparameters.CtypesParameterHandler"
    FormatHandler("byref", handler, [f"{reference.__module__}.{reference.__name__}"], isOutput=True)
    # A check after each of the thousand calls of a frame would double its time.
    OpenGL.ERROR_CHECKING = False
    # pyrender imports its viewer, whose libraries a headless machine lacks.
    window = ModuleType("pyrender.viewer")
    window.Viewer = None
    sys.modules.setdefault(window.__name__, window)


_prepare_imports()

import pyrender  # noqa: E402
from OpenGL import GL  # noqa: E402


class Pass(pyrender.Renderer):
    """Renderer of the visible nodes of a static scene.

    Args:
        scene: its meshes and textures are uploaded at once and their images released.
        size_px: width and height.

    Raises:
        InputError: the driver has no reversed depth buffer of floats.
    """

    def __init__(self, scene: pyrender.Scene, size_px: tuple[int, int]) -> None:
        self._context = shared_context(PYRENDER)
        self._context.make_current()
        super().__init__(*size_px)
        self.visible: list[pyrender.Node] = []
        self._programs: dict[int, _SparingProgram] = {}
        # Rows of bytes may have any length; the default is a multiple of four.
        GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
        GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
        super()._update_context(scene, pyrender.RenderFlags.FLAT)
        for texture in self._mesh_textures:
            texture.source = None
        self._configure_main_framebuffer()
        self._set_clip_control = _clip_control(self._context)

    def draw(self, scene: pyrender.Scene, colours: dict[pyrender.Node, np.ndarray] | None = None) -> None:
        """Draw the visible nodes, textured or in flat colours (3,) of 0 to 255."""
        self._context.make_current()
        flags = pyrender.RenderFlags.FLAT if colours is None else pyrender.RenderFlags.SEG
        self.render(scene, flags | pyrender.RenderFlags.OFFSCREEN, colours)

    def read(self, colours: np.ndarray, zbuffer: np.ndarray) -> None:
        """Read the frame into (H, W, C) uint8 and (H, W) float32, the lowest row first."""
        width, height = self._main_fb_dims
        kind = GL.GL_RED if colours.shape[2] == 1 else GL.GL_RGB
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._main_fb)
        GL.glReadPixels(0, 0, width, height, kind, GL.GL_UNSIGNED_BYTE, colours)
        GL.glReadPixels(0, 0, width, height, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT, zbuffer)

    def delete(self) -> None:
        """Free all OpenGL resources; called again on destruction, whichever context is current."""
        if sys.is_finalizing():
            return
        self._context.make_current()
        super().delete()

    # The following override steps of pyrender's own rendering.

    def _update_context(self, scene, flags) -> None:
        """Do nothing: the scene is static and was uploaded."""

    def _sorted_mesh_nodes(self, scene) -> list[pyrender.Node]:
        """Return the visible nodes; nothing is transparent, so any order will do."""
        return self.visible

    def _get_primitive_program(self, primitive, flags, program_flags):
        """Return one program per flags; all primitives have the same buffers and material."""
        if flags not in self._programs:
            program = super()._get_primitive_program(primitive, flags, program_flags)
            self._programs[flags] = _SparingProgram(program)
        return self._programs[flags]

    def _configure_forward_pass_viewport(self, flags) -> None:
        super()._configure_forward_pass_viewport(flags)
        GL.glDepthFunc(GL.GL_GREATER)
        GL.glClearDepth(0.0)
        self._set_clip_control(_GL_LOWER_LEFT, _GL_ZERO_TO_ONE)

    def _configure_main_framebuffer(self) -> None:
        if self._main_fb is not None:
            return
        size = self.viewport_width, self.viewport_height
        self._main_cb, self._main_db = GL.glGenRenderbuffers(2)
        self._main_fb = GL.glGenFramebuffers(1)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._main_fb)
        for buffer, storage, attachment in (
            (self._main_cb, GL.GL_RGBA8, GL.GL_COLOR_ATTACHMENT0),
            (self._main_db, GL.GL_DEPTH_COMPONENT32F, GL.GL_DEPTH_ATTACHMENT),
        ):
            GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, buffer)
            GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, storage, *size)
            GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, attachment, GL.GL_RENDERBUFFER, buffer)
        status = GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER)
        extensions = GL.glGetString(GL.GL_EXTENSIONS).split()
        if status != GL.GL_FRAMEBUFFER_COMPLETE or b"GL_ARB_clip_control" not in extensions:
            raise InputError("GL", "the driver has no reversed depth in floats", "use Mesa 22 or newer")
        # pyrender's multisampled buffer and the buffer it is resolved into are the same one here.
        self._main_cb_ms, self._main_db_ms, self._main_fb_ms = self._main_cb, self._main_db, self._main_fb
        self._main_fb_dims = size

    def _read_main_framebuffer(self, scene, flags) -> None:
        """Do nothing: ``read`` does this."""


def _clip_control(context: GlContext) -> Callable[[int, int], None]:
    """Return ``glClipControl``, which pyrender's version of PyOpenGL does not have."""
    return ctypes.CFUNCTYPE(None, ctypes.c_uint, ctypes.c_uint)(context.address("glClipControl"))


class _SparingProgram:
    """A shader program that sets a uniform only when its value changes."""

    def __init__(self, program) -> None:
        self._program = program
        self._bind, self._unbind = program._bind, program._unbind
        self._values: dict[str, object] = {}

    def set_uniform(self, name: str, value, unsigned: bool = False) -> None:
        """Set a uniform as ``pyrender.shader_program.ShaderProgram`` does; unknown names are ignored."""
        new = value.tobytes() if isinstance(value, np.ndarray) else value
        if self._values.get(name) != new:
            self._program.set_uniform(name, value, unsigned)
            self._values[name] = new
