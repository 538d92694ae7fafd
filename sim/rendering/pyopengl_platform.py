"""The PyOpenGL platform of pyrender's context; PyOpenGL imports this module itself.

PyOpenGL's own platforms look for libGL or libOSMesa by name; a headless machine may have neither.
This one asks the context of ``sim.rendering.gl_context`` for every GL function.
"""

import ctypes

from OpenGL.platform.baseplatform import BasePlatform

from dslab.sim.rendering.gl_context import PYRENDER, shared_context


class ContextPlatform(BasePlatform):
    """GL functions of pyrender's context, which must be current when PyOpenGL is imported."""

    DEFAULT_FUNCTION_TYPE = staticmethod(ctypes.CFUNCTYPE)
    GL = GLU = GLUT = GLE = None

    def GetCurrentContext(self) -> int:
        """Return the key of PyOpenGL's data per context; there is one context."""
        return 1

    def getExtensionProcedure(self, name: bytes) -> int:
        """Return the address of a GL function, 0 if absent."""
        return shared_context(PYRENDER).address(name.decode())

    def constructFunction(self, functionName, dll, *arguments, **named):
        """Build a function from its address; raises AttributeError if it is absent."""
        named["force_extension"] = True
        return super().constructFunction(functionName, dll, *arguments, **named)
