"""Make headless OpenGL work, once after the install: ``python -m sim.rendering.gl_setup --uv PATH``.

Tries in this order: what is there; Debian's EGL packages, as root where apt-get is; the OSMesa wheel.
"""

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

from sim.rendering.gl_context import REMEDY

_PROBE = """
from scenarios.errors import InputError
from sim.rendering.gl_context import gl_info
try:
    info = gl_info()
except InputError as error:
    raise SystemExit(error.problem)
print(info["backend"], info["renderer"], info["version"], sep=", ")
"""
_PACKAGES = ("libegl1", "libgl1-mesa-dri")
_TIMEOUT_S = 900


def main(arguments: list[str] | None = None) -> int:
    """Find or install a GL implementation, one line per step.

    Args:
        arguments: command line without the program's name.

    Returns:
        0 if a context can be made in the end, 2 otherwise.
    """
    parser = argparse.ArgumentParser(description="Find or install headless OpenGL.")
    parser.add_argument("--uv", type=Path, required=True, help="the uv that installed the packages")
    uv = parser.parse_args(arguments).uv
    works, what = probe()
    if works:
        _say(what)
        return 0
    _say(f"not usable yet: {what}")
    if _can_install_packages():
        _say(f"installing {' '.join(_PACKAGES)} with apt-get")
        install_packages()
        works, what = probe()
    if not works:
        _say("installing the OSMesa library (84 MB) from a wheel")
        install_wheel(uv)
        works, what = probe()
    _say(what if works else f"no headless OpenGL: {REMEDY}")
    return 0 if works else 2


def probe() -> tuple[bool, str]:
    """Whether a context can be made, and its name or why not; apart, as a driver can crash its process."""
    try:
        run = subprocess.run(
            [sys.executable, "-c", _PROBE], capture_output=True, text=True, timeout=60, check=False
        )
    except subprocess.TimeoutExpired:
        return False, "making a GL context hangs"
    if run.returncode == 0:
        return True, run.stdout.strip()
    reason = run.stderr.strip().splitlines()
    return False, reason[-1] if reason else f"making a GL context ends with signal {-run.returncode}"


def install_packages() -> bool:
    """Install Debian's EGL and software renderer; the caller is root."""
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    # A bare machine has no package lists. Where they cannot be fetched, the packages may still be cached.
    _run(["apt-get", "-qq", "update"], environment)
    install = ["apt-get", "-qq", "install", "-y", "--no-install-recommends", *_PACKAGES]
    return _run(install, environment)


def install_wheel(uv: Path) -> bool:
    """Add the locked extra ``osmesa`` to the environment, leaving everything else in it as it is."""
    # Both extras are named because a sync replaces the set of extras it was last given.
    return _run(
        [str(uv), "sync", "--quiet", "--frozen", "--inexact", "--extra", "osmesa", "--extra", "evo"],
        os.environ,
    )


def _can_install_packages() -> bool:
    if os.environ.get("DSLAB_GL") == "osmesa":
        return False  # the packages bring EGL
    return sys.platform == "linux" and os.geteuid() == 0 and shutil.which("apt-get") is not None


def _run(command: list[str], environment) -> bool:
    """Run an installer; a failure is one line, since the next route may work."""
    try:
        run = subprocess.run(
            command, env=dict(environment), capture_output=True, text=True, timeout=_TIMEOUT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        _say(f"{Path(command[0]).name} failed: {error}")
        return False
    if run.returncode:
        lines = (run.stderr.strip() or run.stdout.strip() or "no message").splitlines()
        _say(f"{Path(command[0]).name} failed: {lines[-1]}")
    return run.returncode == 0


def _say(text: str) -> None:
    print(f"dslab setup: GL: {text}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
