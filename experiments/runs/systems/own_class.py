"""Classes of one's own as systems: found by an entry point, or named as ``module:Class``."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from dslab.experiments.plugins import module_of, of_others
from dslab.experiments.runs.systems.poses_only import PosesOnly
from dslab.scenarios.errors import InputError
from dslab.slam.core.camera import PinholeCamera

GROUP = "dslab.systems"
"""Group of entry points; each names a class, made with (camera, seed)."""
_NAMED = re.compile(r"[\w./\\-]+:\w+")


@dataclass(frozen=True)
class ClassSystem:
    """A class of someone else's.

    Attributes:
        name: of the system.
        make: the class, or a function, of (camera, seed).
        source: where it comes from, as ``module:Class``.
    """

    name: str
    make: Callable[[PinholeCamera, int], Any]
    source: str

    def build(self, camera: PinholeCamera, seed: int) -> PosesOnly:
        """Make one, in the adapter that a run needs.

        Raises:
            InputError: its constructor raises, or makes an object without ``process``.
        """
        with of_others(self.source, "cannot be made with (camera, seed)", "correct its constructor"):
            made = self.make(camera, seed)
            has_process = callable(getattr(made, "process", None))
        if not has_process:
            raise InputError(self.source, "has no process(image, stamp_s)", "see `examples/own_slam.py`")
        return PosesOnly(made, camera, self.source)


def is_class_name(name: str) -> bool:
    """Return True for ``module:Class`` or ``path/to/file.py:Class``."""
    return _NAMED.fullmatch(name) is not None


def class_system(named: str) -> ClassSystem:
    """The class that a name stands for; its module may lie in the present folder.

    Raises:
        InputError: there is no such module or class, or it cannot be imported.
    """
    module_name, _, class_name = named.rpartition(":")
    where = f"system {named}"
    with of_others(where, "cannot be imported", "check its name and its imports"):
        found = getattr(module_of(module_name), class_name, None)
    return ClassSystem(class_name, _callable(found, where), named)


def entry_point_names() -> dict[str, EntryPoint]:
    """The systems that installed packages bring, by name."""
    return {point.name: point for point in sorted(entry_points(group=GROUP), key=lambda p: p.name)}


def entry_point_system(point: EntryPoint) -> ClassSystem:
    """The class of an entry point. Raises InputError if it cannot be loaded."""
    where = f"system {point.name} ({point.value})"
    with of_others(where, "cannot be loaded", "correct or uninstall it"):
        found = point.load()
    return ClassSystem(point.name, _callable(found, where), point.value)


def _callable(found: Any, where: str) -> Callable[[PinholeCamera, int], Any]:
    if not callable(found):
        raise InputError(where, "is no class", "name a class, made with (camera, seed)")
    return found
