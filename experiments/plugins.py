"""Plugins: modules that register worlds, motions, degradations or recovery threads in every process."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
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
    """Import every plugin, once per process; returns their names.

    Raises:
        InputError: a plugin cannot be imported, or raises.
    """
    loaded = []
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        where, remedy = f"plugin {point.name} ({point.value})", "correct or uninstall it"
        with of_others(where, "cannot be loaded", remedy):
            found = point.load()
            if callable(found):
                found()
        loaded.append(point.name)
    for name in filter(None, (part.strip() for part in os.environ.get(VARIABLE, "").split(","))):
        with of_others(
            f"{VARIABLE}: {name}", "cannot be loaded", "correct it, or take it out of the variable"
        ):
            import_module(name)
        loaded.append(name)
    return tuple(loaded)


@contextmanager
def of_others(where: str, problem: str, remedy: str) -> Iterator[None]:
    """Turn whatever another's code raises into one line. Raises InputError."""
    try:
        yield
    except Exception as error:
        said = " ".join(f"{problem} ({type(error).__name__}: {error})".split())
        raise InputError(where, said, remedy) from error
