"""Environments of Python for programs that must stay apart, in the user's cache folder."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from dslab.experiments.runs.systems.command_spec import Environment
from dslab.scenarios.errors import InputError, MachineError
from dslab.sim.cache import default_cache_dir
from dslab.sim.unfinished import unfinished_folder

_FOLDER = "systems"
_MARK = "dslab-packages.txt"
_TIME_S = 1800.0


def environment_folder(name: str) -> Path:
    """Folder of a system's environment, whether it is there or not."""
    return default_cache_dir() / _FOLDER / name


def is_installed(name: str, environment: Environment) -> bool:
    """Return True if the environment is whole and has the packages that the description names."""
    mark = environment_folder(name) / _MARK
    try:
        return mark.read_text(encoding="utf-8").splitlines() == list(environment.packages)
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
        problem = f"{' '.join(environment.packages)} is not installed for it"
        raise InputError(f"system {name}", problem, f"run `dslab systems install {name}`")
    return _python(environment_folder(name))


def install(name: str, environment: Environment) -> Path:
    """Make the environment of a system, whole or not at all, in place of an earlier one.

    It is made by uv if that is on the PATH, else by venv and pip.

    Returns:
        Its folder.

    Raises:
        MachineError: the packages cannot be installed, or not imported afterwards.
        InputError: the cache folder cannot be written.
    """
    place = environment_folder(name)
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        # Environments name their own place: this one is made there, and marked when it is whole.
        with unfinished_folder(place.parent, f".{name}.old-") as aside:
            if place.exists():
                place.rename(aside / "environment")
        try:
            _make(place, environment)
            (place / _MARK).write_text("\n".join(environment.packages) + "\n", encoding="utf-8")
        except BaseException:
            shutil.rmtree(place, ignore_errors=True)
            raise
    except OSError as error:
        problem = f"cannot be written ({error.strerror or error})"
        raise InputError(str(place), problem, "free space or set DSLAB_CACHE_DIR to another folder") from None
    return place


def _make(place: Path, environment: Environment) -> None:
    uv = shutil.which("uv")
    if uv is not None:
        _run([uv, "venv", "--quiet", "--python", sys.executable, str(place)])
        _run([uv, "pip", "install", "--quiet", "--python", str(_python(place)), *environment.packages])
    else:
        _run([sys.executable, "-m", "venv", str(place)])
        pip = [str(_python(place)), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        _run([*pip, *environment.packages])
    for module in environment.imports:
        _run([str(_python(place)), "-c", f"import {module}"], environment.note)


def _python(place: Path) -> Path:
    return place / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def _run(words: list[str], remedy: str = "") -> None:
    """Run a step. Raises MachineError with the last line that it prints if it fails."""
    where = " ".join(words[:3])
    remedy = remedy or "check the network and the version of Python, and run the same command again"
    try:
        done = subprocess.run(
            words, stdin=subprocess.DEVNULL, capture_output=True, timeout=_TIME_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise MachineError(where, f"cannot be run ({error})", remedy) from None
    if done.returncode != 0:
        lines = (done.stderr + done.stdout).decode(errors="replace").strip().splitlines()
        last = lines[-1].strip() if lines else "no message"
        raise MachineError(where, f"ended with exit code {done.returncode}: {last}", remedy)
