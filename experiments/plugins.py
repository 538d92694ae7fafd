"""Plugins: modules that register worlds, motions, degradations or recovery threads in every process."""

import os
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points

from dslab.scenarios.errors import InputError

GROUP = "dual_slam_lab.plugins"
"""Group of entry points; each names a module, or a function without arguments, that registers something."""
VARIABLE = "DSLAB_PLUGINS"
"""Environment variable with the names of further modules, separated by commas."""


@cache
def load_plugins() -> tuple[str, ...]:
    """Import every plugin, once per process.

    Returns:
        Names of the plugins.

    Raises:
        InputError: a plugin cannot be imported, or raises.
    """
    loaded = []
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        with _Guarded(f"plugin {point.name} ({point.value})", "correct or uninstall it"):
            found = point.load()
            if callable(found):
                found()
        loaded.append(point.name)
    for name in filter(None, (part.strip() for part in os.environ.get(VARIABLE, "").split(","))):
        with _Guarded(f"{VARIABLE}: {name}", "correct it, or take it out of the variable"):
            import_module(name)
        loaded.append(name)
    return tuple(loaded)


class _Guarded:
    """Turns whatever a plugin raises into one line that names it."""

    def __init__(self, where: str, remedy: str) -> None:
        self._where, self._remedy = where, remedy

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, Exception):
            problem = f"cannot be loaded ({type(error).__name__}: {error})"
            raise InputError(self._where, problem, self._remedy) from error
