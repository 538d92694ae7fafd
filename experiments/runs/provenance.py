"""Provenance of a result: the code's commit, versions, the machine."""

import hashlib
import json
import os
import platform
import subprocess
from functools import cache
from importlib import metadata
from pathlib import Path

from dslab.scenarios.extensions import extension_digests, source_digest

DISTRIBUTION = "dual-slam-lab"
_REPORTED = (
    "numpy",
    "numba",
    "opencv-contrib-python-headless",
    "scipy",
    "mujoco",
    "pyrender",
    "pyopengl",
    "rerun-sdk",
)


@cache
def commit() -> str | None:
    """Git commit of the running code, with ``-dirty`` if it was changed; None outside a work tree."""
    folder = checkout()
    if folder is None:
        return None
    head = _git(folder, "rev-parse", "HEAD")
    if head is None:
        return None
    return head + ("-dirty" if _git(folder, "status", "--porcelain") else "")


def checkout() -> Path | None:
    """Work tree that the running code lies in; None if there is none."""
    folder = Path(__file__).resolve().parents[2]
    return folder if (folder / ".git").exists() else None


def release() -> str:
    """The code at hand as `dslab systems install lab@…` builds it: its commit, else its version."""
    return (commit() or versions()[DISTRIBUTION]).removesuffix("-dirty")


def code_hash() -> str:
    """Hash of all that makes images and poses: scenarios, sim and slam with their data, and extensions."""
    from dslab.slam.dual.recovery.registry import RECOVERY_KINDS

    extensions = extension_digests() | {
        f"recovery thread: {kind}": source_digest(thread)
        for kind, thread in RECOVERY_KINDS.items()
        if not thread.__module__.startswith("dslab.slam.")
    }
    own = _package_hash()
    if not extensions:
        return own
    return hashlib.sha256(json.dumps([own, sorted(extensions.items())]).encode()).hexdigest()[:16]


@cache
def _package_hash() -> str:
    digest = hashlib.sha256()
    root = Path(__file__).resolve().parents[2]
    for package in ("scenarios", "sim", "slam"):
        for path in sorted((root / package).rglob("*")):
            if path.suffix in (".py", ".npz"):
                digest.update(path.relative_to(root).as_posix().encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def versions() -> dict[str, str]:
    """Versions of Python, of this project and of the packages that affect its results."""
    found = {"python": platform.python_version(), DISTRIBUTION: _version(DISTRIBUTION)}
    return found | {name: _version(name) for name in _REPORTED}


def usable_cores() -> int:
    """Cores this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments], capture_output=True, text=True, timeout=10, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None
