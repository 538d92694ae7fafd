"""PyOpenGL's view of a context of ``sim.rendering.gl_context``; PyOpenGL imports this module itself.

Its own platforms look for libGL or libOSMesa by name, which a headless machine lacks or hides in a wheel.
Here every GL function is what the context says it is.
"""

import ctypes

from OpenGL.platform.baseplatform import BasePlatform

from sim.rendering.gl_context import PYRENDER, shared_context


class ContextPlatform(BasePlatform):
    """GL functions of the context of pyrender, which must be current when PyOpenGL is imported."""

    DEFAULT_FUNCTION_TYPE = staticmethod(ctypes.CFUNCTYPE)
    GL = GLU = GLUT = GLE = None

    def GetCurrentContext(self) -> int:
        """A key for what PyOpenGL keeps per context; there is only one."""
        return 1

    def getExtensionProcedure(self, name: bytes) -> int:
        """Address of a GL function, 0 if absent."""
        return shared_context(PYRENDER).address(name.decode())

    def constructFunction(self, functionName, dll, *arguments, **named):
        """A function by its address; raises AttributeError if it is absent."""
        named["force_extension"] = True
        return super().constructFunction(functionName, dll, *arguments, **named)
