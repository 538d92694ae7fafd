"""Plugins: modules that register worlds, motions, degradations or recovery threads in every process."""

import os
import sys
import sysconfig
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from threading import get_ident
from types import ModuleType
from typing import NoReturn

from dslab.scenarios.errors import InputError

GROUP = "dual_slam_lab.plugins"
"""Group of entry points; each names a module, or a function without arguments, that registers something."""
VARIABLE = "DSLAB_PLUGINS"
"""Environment variable with further modules, separated by commas: names, or files that end with ``.py``."""
_MOST_WORDS, _MOST_LOG = 1000, 100_000
_SOURCE = "__dslab_source__"
_LIBRARIES = tuple({sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")})


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
            module_of(name)
        loaded.append(name)
    return tuple(loaded)


def module_of(name: str) -> ModuleType:
    """Import a module by its name, also from the present folder, or from a file that ends with ``.py``.

    Raises whatever the module raises, and ImportError if there is none.
    """
    if name.endswith(".py"):
        return _file_module(Path(name))
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)
    return import_module(name)


def _file_module(path: Path) -> ModuleType:
    # Under its place: its name may be that of any other module.
    spec = spec_from_file_location(str(path.absolute()), path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ImportError(f"no such file: {path}")
    source = path.read_bytes()
    known = sys.modules.get(spec.name)
    if getattr(known, _SOURCE, None) == source:  # what it registers, it registers once
        return sys.modules[spec.name]
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # where its source is looked for
    spec.loader.exec_module(module)
    setattr(module, _SOURCE, source)
    return module


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
    """What another's code has raised, and where in it, in one line; its message may raise as well."""
    try:
        words = f"{type(error).__name__}: {error}"
    except KeyboardInterrupt:
        raise
    except BaseException:
        words = f"{type(error).__name__}, without words"
    return " ".join(words.split())[:_MOST_WORDS] + _place_of(error)


def log_of(error: BaseException) -> str:
    """The traceback of what another's code has raised."""
    try:
        return "".join(traceback.format_exception(error))[-_MOST_LOG:]
    except KeyboardInterrupt:
        raise
    except BaseException:
        return "".join(traceback.format_tb(error.__traceback__))


def _place_of(error: BaseException) -> str:
    """The line of another's own code, not of a library that it calls; empty if none is known."""
    own = [
        (frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if not str(frame.f_globals.get("__name__")).startswith("dslab.")
    ]
    own = [place for place in own if not place[0].startswith(("<", *_LIBRARIES))]
    return f", at {own[-1][0]}:{own[-1][1]}" if own else ""
