"""Plugins: modules that register worlds, motions, degradations or recovery threads in every process."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from threading import get_ident
from typing import NoReturn

from dslab.scenarios.errors import InputError

GROUP = "dual_slam_lab.plugins"
"""Group of entry points; each names a module, or a function without arguments, that registers something."""
VARIABLE = "DSLAB_PLUGINS"
"""Environment variable with the names of further modules, separated by commas."""
_MOST_WORDS = 1000


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
    """Turn whatever another's code raises, or its end of the process, into one line. Raises InputError."""
    try:
        with no_exit():
            yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise InputError(where, f"{problem} ({words_of(error)})", remedy) from error


@contextmanager
def no_exit() -> Iterator[None]:
    """Make ``os._exit`` raise SystemExit in this thread: another's code does not end the lab unheard."""
    ends, process, thread = os._exit, os.getpid(), get_ident()

    def raises(status: int) -> NoReturn:
        if (os.getpid(), get_ident()) == (process, thread):
            raise SystemExit(f"os._exit({status})")
        ends(status)

    os._exit = raises
    try:
        yield
    finally:
        os._exit = ends


def words_of(error: BaseException) -> str:
    """Kind and message of what another's code has raised, in one line; its message may raise as well."""
    try:
        words = f"{type(error).__name__}: {error}"
    except KeyboardInterrupt:
        raise
    except BaseException:
        words = f"{type(error).__name__}, without words"
    return " ".join(words.split())[:_MOST_WORDS]
