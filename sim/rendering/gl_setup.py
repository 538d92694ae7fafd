"""Check headless OpenGL once after the install: ``python -m dslab.sim.rendering.gl_setup --uv PATH``.

Where no driver works it adds the OSMesa wheel, which needs no root, and names the command for EGL.
"""

import argparse
import subprocess
import sys
from pathlib import Path

from dslab.sim.rendering.gl_context import EGL_COMMAND, OSMESA_WHEEL, REMEDY

_PROBE = """
from dslab.scenarios.errors import InputError
from dslab.sim.rendering.gl_context import gl_info
try:
    info = gl_info()
except InputError as error:
    raise SystemExit(error.problem)
print(info["backend"], info["renderer"], info["version"], sep=", ")
"""
_PROBE_TIMEOUT_S, _INSTALL_TIMEOUT_S = 60, 900


def main(arguments: list[str] | None = None) -> int:
    """Find a GL implementation or install the OSMesa wheel, one line per step.

    Args:
        arguments: command line without the program's name.

    Returns:
        0 if a context can be created in the end, 2 otherwise.
    """
    parser = argparse.ArgumentParser(
        description="Check headless OpenGL; install the OSMesa wheel if it fails."
    )
    parser.add_argument("--uv", type=Path, required=True, help="the uv that installed the packages")
    uv = parser.parse_args(arguments).uv
    works, text = probe()
    if not works:
        _say(f"not usable yet: {text}")
        _say(f"installing the OSMesa library (84 MB) as a wheel; for EGL instead: {EGL_COMMAND}")
        install_wheel(uv)
        works, text = probe()
    _say(text if works else f"no headless OpenGL: {REMEDY}")
    return 0 if works else 2


def probe() -> tuple[bool, str]:
    """Try to create a context, in a child process because a driver can crash its process.

    Returns:
        True and the name of the context, or False and the reason.
    """
    try:
        run = subprocess.run(
            [sys.executable, "-c", _PROBE],
            capture_output=True,
            text=True,
            timeout=_PROBE_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False, "creating a GL context hangs"
    if run.returncode == 0:
        return True, run.stdout.strip()
    reason = run.stderr.strip().splitlines()
    return False, reason[-1] if reason else f"creating a GL context ends with signal {-run.returncode}"


def install_wheel(uv: Path) -> None:
    """Add the OSMesa wheel to this environment; a failure is one line."""
    # Its declared dependencies serve a viewer, not the library.
    command = [str(uv), "pip", "install", "--quiet", "--python", sys.executable, "--no-deps", OSMESA_WHEEL]
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=_INSTALL_TIMEOUT_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        _say(f"uv failed: {error}")
        return
    if run.returncode:
        lines = (run.stderr.strip() or run.stdout.strip() or "no message").splitlines()
        _say(f"uv failed: {lines[-1]}")


def _say(text: str) -> None:
    print(f"dslab setup: GL: {text}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
