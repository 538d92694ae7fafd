"""Everything on which rendered frames depend: kept with them, and the key of their place in the cache."""

import hashlib
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from dslab import scenarios
from dslab.scenarios.extensions import extension_digests
from dslab.scenarios.spec import Scenario
from dslab.sim.cache import content_key
from dslab.sim.frame_plan import RenderBackend

_PACKAGES = (
    "dual-slam-lab",
    "mujoco",
    "numba",
    "numpy",
    "opencv-contrib-python-headless",
    "pyopengl",
    "pyrender",
    "scipy",
)


def entry_key(scenario: Scenario, backend: RenderBackend, **what: Any) -> str:
    """Key of what is cached of a scenario.

    Args:
        scenario: what happens.
        backend: worlds and renderer.
        what: tells apart what is kept of it, for example ``depth=True``; None for nothing.
    """
    # Inertial readings change no frame.
    frames = provenance(scenario.model_copy(update={"imu": None}), backend)
    told = {name: value for name, value in what.items() if value is not None}
    return content_key({**told, "sources": sources(), **frames})


def provenance(scenario: Scenario, backend: RenderBackend) -> dict[str, Any]:
    """The meta data of rendered frames, JSON-like."""
    return {
        "spec": scenario.model_dump(mode="json"),
        "seed": scenario.seed,
        "versions": {"python": platform.python_version(), **_versions()},
        "renderer": backend.renderer_name,
        "gl": backend.gl_info(),
        "stamps": "centre of the exposure",
        "poses": "camera (x right, y down, z forward) to world (z up), metres, at the stamp",
    }


@cache
def _versions() -> dict[str, str]:
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found


@cache
def _source_hash() -> str:
    """Hash of every source file that can change a pixel; part of the cache key."""
    digest = hashlib.sha256()
    for root in (Path(str(scenarios.__file__)).parent, Path(__file__).parent):
        for path in sorted(root.rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def sources() -> dict[str, str]:
    """Digests of the sources of the packages and of the registered extensions."""
    return {"packages": _source_hash(), **extension_digests()}
