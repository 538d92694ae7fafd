"""Environments of Python for programs that must stay apart, in the user's cache folder."""

import os
import shutil
import sys
from pathlib import Path

from dslab.experiments.runs.systems.command_spec import Environment
from dslab.experiments.runs.systems.release_source import release_source, run_step
from dslab.scenarios.errors import InputError
from dslab.sim.cache import default_cache_dir
from dslab.sim.unfinished import scratch_folder, unfinished_folder

_FOLDER = "systems"
_MARK = "dslab-packages.txt"
_TIME_S = 1800.0


def environment_folder(name: str, environment: Environment) -> Path:
    """Folder of a system's environment, whether it is there or not; that of a commit has many systems."""
    name = name if environment.commit is None else f"lab@{environment.commit[:12]}"
    return default_cache_dir() / _FOLDER / name


def is_installed(name: str, environment: Environment) -> bool:
    """Return True if the environment is whole and has what the description names."""
    mark = environment_folder(name, environment) / _MARK
    try:
        return mark.read_text(encoding="utf-8").splitlines() == list(environment.contents)
    except OSError:
        return False


def python_of(name: str, environment: Environment | None) -> Path:
    """Python of a system's environment; the one that runs, for a system without its own.

    Raises:
        InputError: the environment is not installed, or has other packages.
    """
    if environment is None:
        return Path(sys.executable)
    if not is_installed(name, environment):
        problem = f"{' '.join(environment.contents)} is not installed for it"
        raise InputError(f"system {name}", problem, f"run `dslab systems install {name}`")
    return _python(environment_folder(name, environment))


def install(name: str, environment: Environment, repository: str | None = None) -> Path:
    """Make the environment of a system, whole or not at all, in place of an earlier one.

    It is made by uv if that is on the PATH, else by venv and pip.

    Args:
        name: of the system.
        environment: what it holds.
        repository: folder or address of this lab's repository, for a commit of it; None for the checkout
            that the running lab lies in.

    Returns:
        Its folder.

    Raises:
        MachineError: the packages cannot be installed, or not imported afterwards.
        InputError: the cache folder cannot be written, or the commit is not to be had.
    """
    place = environment_folder(name, environment)
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        # Environments name their own place: this one is made there, and marked when it is whole.
        with unfinished_folder(place.parent, f".{name}.old-") as aside:
            if place.exists():
                place.rename(aside / "environment")
        try:
            with scratch_folder() as scratch:
                wanted = [*environment.packages]
                if environment.commit is not None:
                    wanted = release_source(environment.commit, repository, scratch)
                _make(place, environment, wanted)
            if environment.commit is not None:
                # Its kernels are kept beside its packages, so that no run compiles them.
                run_step([str(_python(place)), "-E", "-s", str(_python(place).with_name("dslab")), "warmup"])
            (place / _MARK).write_text("\n".join(environment.contents) + "\n", encoding="utf-8")
        except BaseException:
            shutil.rmtree(place, ignore_errors=True)
            raise
    except OSError as error:
        problem = f"cannot be written ({error.strerror or error})"
        raise InputError(str(place), problem, "free space or set DSLAB_CACHE_DIR to another folder") from None
    return place


def _make(place: Path, environment: Environment, wanted: list[str]) -> None:
    uv = shutil.which("uv")
    if uv is not None:
        run_step([uv, "venv", "--quiet", "--python", sys.executable, str(place)])
        run_step([uv, "pip", "install", "--quiet", "--python", str(_python(place)), *wanted])
    else:
        run_step([sys.executable, "-m", "venv", str(place)])
        pip = [str(_python(place)), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        run_step([*pip, *wanted])
    for module in environment.imports:
        run_step([str(_python(place)), "-c", f"import {module}"], environment.note)


def _python(place: Path) -> Path:
    return place / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
