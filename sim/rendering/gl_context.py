"""A headless OpenGL context, created through ctypes: EGL without a surface, else OSMesa.

MuJoCo's own context classes need PyOpenGL and a choice by environment variable, and its OSMesa class crashes
on close. With this module MuJoCo finds a current context and creates none. Import it before ``mujoco``.

``DSLAB_GL`` = ``egl`` or ``osmesa`` forces a backend, ``software`` is EGL without a GPU;
``DSLAB_OSMESA_LIBRARY`` names the OSMesa library.
"""

import ctypes
import functools
import os
import sys
import sysconfig
from ctypes import c_char_p, c_int, c_void_p
from pathlib import Path
from typing import Protocol

from dslab.scenarios.errors import InputError

# MuJoCo must not load a GL library itself.
os.environ["MUJOCO_GL"] = "disable"

EGL_COMMAND = "apt-get install libegl1 libgl1-mesa-dri"
OSMESA_WHEEL = "lavavu-osmesa==1.9.10"
REMEDY = (
    f"install EGL (Debian, Ubuntu: {EGL_COMMAND}) or, without root, the OSMesa library"
    f" (pip --python {sys.executable} install --no-deps {OSMESA_WHEEL})"
)
MUJOCO, PYRENDER = "mujoco", "pyrender"  # the users of contexts
_GL_VENDOR, _GL_RENDERER, _GL_VERSION, _GL_RGBA, _GL_UNSIGNED_BYTE = 0x1F00, 0x1F01, 0x1F02, 0x1908, 0x1401


class GlUnavailableError(Exception):
    """Report that one backend cannot create a context, with the reason."""


class GlContext(Protocol):
    """An OpenGL context of one backend, without a window."""

    backend: str

    def make_current(self) -> None:
        """Bind the context to the calling thread; raises GlUnavailableError on failure."""
        ...

    def address(self, function: str) -> int:
        """Return the address of a GL function, 0 if absent; the context must be current."""
        ...


def _function(library: ctypes.CDLL, name: str, result: type | None, *arguments: type):
    function = getattr(library, name)
    function.restype, function.argtypes = result, arguments
    return function


class EglContext:
    """EGL context without a surface, on the first working GPU, else in Mesa's software renderer.

    Args:
        gpu: False to use no GPU; Mesa's software renderer gives the same frames on every machine.
    """

    backend = "egl"

    _SURFACELESS_MESA, _DEVICE_EXT, _EXTENSIONS = 0x31DD, 0x313F, 0x3055
    _OPENGL_API, _OPENGL_BIT, _RENDERABLE_TYPE, _SURFACE_TYPE, _NONE = 0x30A2, 0x0008, 0x3040, 0x3033, 0x3038

    def __init__(self, gpu: bool = True) -> None:
        try:
            egl = ctypes.CDLL("libEGL.so.1")
        except OSError as error:
            raise GlUnavailableError(f"EGL: {error}") from error
        self._address = _function(egl, "eglGetProcAddress", c_void_p, c_char_p)
        self._initialize = _function(egl, "eglInitialize", c_int, c_void_p, c_void_p, c_void_p)
        self._bind_api = _function(egl, "eglBindAPI", c_int, ctypes.c_uint)
        self._choose = _function(egl, "eglChooseConfig", c_int, c_void_p, c_void_p, c_void_p, c_int, c_void_p)
        self._create = _function(egl, "eglCreateContext", c_void_p, c_void_p, c_void_p, c_void_p, c_void_p)
        self._make_current = _function(egl, "eglMakeCurrent", c_int, c_void_p, c_void_p, c_void_p, c_void_p)
        for display in self._displays(gpu):
            context = self._context_on(display)
            if context:
                self._display, self._context = display, context
                return
        raise GlUnavailableError("EGL: no display offers desktop OpenGL")

    def _displays(self, gpu: bool):
        """Yield initialised displays, the preferred first."""
        address = self._address(b"eglGetPlatformDisplayEXT")
        if not address:
            return
        display_of = ctypes.CFUNCTYPE(c_void_p, c_int, c_void_p, c_void_p)(address)
        devices = self._devices()
        gpus = [device for device in devices if not self._is_software(device)]
        candidates = [(self._DEVICE_EXT, device) for device in gpus] if gpu else []
        candidates += [(self._SURFACELESS_MESA, None)]
        candidates += [(self._DEVICE_EXT, device) for device in devices if device not in gpus]
        for platform, native in candidates:
            display = display_of(platform, native, None)
            if display and self._initialize(display, None, None):
                yield display

    def _devices(self) -> list[int]:
        address = self._address(b"eglQueryDevicesEXT")
        if not address:
            return []
        query = ctypes.CFUNCTYPE(c_int, c_int, c_void_p, c_void_p)(address)
        devices, count = (c_void_p * 16)(), c_int()
        if not query(16, devices, ctypes.byref(count)):
            return []
        return [d for d in devices[: count.value] if d]

    def _is_software(self, device: int) -> bool:
        address = self._address(b"eglQueryDeviceStringEXT")
        text = (
            ctypes.CFUNCTYPE(c_char_p, c_void_p, c_int)(address)(device, self._EXTENSIONS)
            if address
            else None
        )
        return b"EGL_MESA_device_software" in (text or b"")

    def _context_on(self, display: int) -> int | None:
        """Create a context that becomes current without a surface, or return None."""
        if not self._bind_api(self._OPENGL_API):
            return None
        wanted = (c_int * 5)(self._RENDERABLE_TYPE, self._OPENGL_BIT, self._SURFACE_TYPE, 0, self._NONE)
        config, count = c_void_p(), c_int()
        if not self._choose(display, wanted, ctypes.byref(config), 1, ctypes.byref(count)) or not count.value:
            return None
        context = self._create(display, config, None, None)
        return context if context and self._make_current(display, None, None, context) else None

    def make_current(self) -> None:
        """Bind the context to the calling thread."""
        # The bound API is per thread.
        if not self._bind_api(self._OPENGL_API) or not self._make_current(
            self._display, None, None, self._context
        ):
            raise GlUnavailableError("EGL: the context is in use by another thread")

    def address(self, function: str) -> int:
        """Return the address of a GL function, 0 if absent."""
        return self._address(function.encode()) or 0


class OsMesaContext:
    """OSMesa context: Mesa's software renderer, drawing into memory of this process."""

    backend = "osmesa"

    _SIZE_PX = 16  # frames are rendered into framebuffer objects; this buffer is never read

    def __init__(self) -> None:
        library = self._load()
        self._address = _function(library, "OSMesaGetProcAddress", c_void_p, c_char_p)
        self._make_current = _function(
            library, "OSMesaMakeCurrent", c_int, c_void_p, c_void_p, c_int, c_int, c_int
        )
        create = _function(library, "OSMesaCreateContextExt", c_void_p, c_int, c_int, c_int, c_int, c_void_p)
        self._context = create(_GL_RGBA, 24, 8, 0, None)
        if not self._context:
            raise GlUnavailableError("OSMesa: the library creates no context")
        self._buffer = (ctypes.c_ubyte * (4 * self._SIZE_PX**2))()
        self.make_current()

    @staticmethod
    def _load() -> ctypes.CDLL:
        named = os.environ.get("DSLAB_OSMESA_LIBRARY")
        names = [named] if named else ["libOSMesa.so.8", "libOSMesa.so.6", *_osmesa_in_wheel()]
        problems = []
        for name in names:
            try:
                _load_neighbours(Path(name))
                # Global because MuJoCo looks up the GL functions among the loaded symbols.
                return ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)
            except OSError as error:
                problems.append(str(error))
        raise GlUnavailableError("OSMesa: " + ", ".join(problems))

    def make_current(self) -> None:
        """Bind the context to the calling thread."""
        if not self._make_current(
            self._context, self._buffer, _GL_UNSIGNED_BYTE, self._SIZE_PX, self._SIZE_PX
        ):
            raise GlUnavailableError("OSMesa: the context cannot be made current")

    def address(self, function: str) -> int:
        """Return the address of a GL function, 0 if absent."""
        return self._address(function.encode()) or 0


def _osmesa_in_wheel() -> list[str]:
    """Return the paths of the OSMesa libraries that the wheel put into site-packages."""
    packages = Path(sysconfig.get_paths()["platlib"])
    return sorted(str(path) for path in packages.glob("lavavu_osmesa.libs/libOSMesa*.so*"))


def _load_neighbours(library: Path) -> None:
    """Load the libraries that a wheel ships beside ``library``, which do not find each other."""
    if not library.parent.name.endswith(".libs"):
        return
    waiting = [path for path in sorted(library.parent.glob("*.so*")) if path != library]
    while waiting:
        left = []
        for path in waiting:
            try:
                ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
            except OSError:
                left.append(path)  # one of its dependencies comes later
        if len(left) == len(waiting):
            return
        waiting = left


_BACKENDS = {
    "egl": EglContext,
    "osmesa": OsMesaContext,
    "software": functools.partial(EglContext, gpu=False),
}
_DEFAULTS = ("egl", "osmesa")


@functools.cache
def shared_context(user: str = MUJOCO) -> GlContext:
    """Return the process's one context of a user, created and made current by the first call.

    It can be current in one thread at a time. A process that has created it must not fork.

    Args:
        user: the library whose GL state the context holds; libraries must not share one.

    Raises:
        InputError: no backend works, or ``DSLAB_GL`` is unknown.
    """
    forced = os.environ.get("DSLAB_GL", "")
    if forced and forced not in _BACKENDS:
        raise InputError("DSLAB_GL", f"unknown GL backend {forced!r}", f"use one of {', '.join(_BACKENDS)}")
    problems = []
    for name in [forced] if forced else _DEFAULTS:
        try:
            return _BACKENDS[name]()
        except GlUnavailableError as error:
            problems.append(str(error))
    raise InputError("GL", "no headless OpenGL here (" + "; ".join(problems) + ")", REMEDY)


def gl_info() -> dict[str, str]:
    """Return backend, vendor, renderer and version of MuJoCo's context, by these names.

    Raises:
        InputError: no backend works.
    """
    context = shared_context()
    context.make_current()
    get_string = ctypes.CFUNCTYPE(c_char_p, c_int)(context.address("glGetString"))
    names = {"vendor": _GL_VENDOR, "renderer": _GL_RENDERER, "version": _GL_VERSION}
    strings = {name: (get_string(value) or b"").decode() for name, value in names.items()}
    return {"backend": context.backend, **strings}
