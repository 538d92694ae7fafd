"""Renderers by name: classes ``(world, camera)`` with the interface ``Renderer``."""

from collections.abc import Callable
from importlib import import_module

from dslab.scenarios.errors import InputError
from dslab.sim.rendering.renderer import Renderer
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.worlds.base import WorldModel

# Import paths: the libraries of a renderer are imported only when it is used.
RENDERERS = {
    "mujoco": "dslab.sim.rendering.mujoco_renderer:MujocoRenderer",
    "pyrender": "dslab.sim.rendering.pyrender_renderer:PyrenderRenderer",
}
DEFAULT_RENDERER = "mujoco"


def load_renderer(name: str) -> Callable[[WorldModel, Intrinsics], Renderer]:
    """The class of a renderer.

    Raises:
        InputError: the name is unknown, OpenGL is missing, or its libraries are not installed.
    """
    check_renderer(name)
    module, _, kind = RENDERERS[name].partition(":")
    try:
        return getattr(import_module(module), kind)
    except ImportError as error:
        raise InputError(f"renderer {name}", str(error), "reinstall dual-slam-lab") from error


def check_renderer(name: str) -> None:
    """Raise InputError if no renderer has that name."""
    if name not in RENDERERS:
        raise InputError("--renderer", f"unknown renderer {name!r}", f"use one of {', '.join(RENDERERS)}")
