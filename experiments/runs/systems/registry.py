"""The registry of systems: ours, classes of packages, programs that a YAML file describes."""

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint
from pathlib import Path

from dslab.experiments.runs.systems.command import CommandSystem
from dslab.experiments.runs.systems.command_spec import OWN_FOLDER, Environment, read_command_spec
from dslab.experiments.runs.systems.own_class import (
    ClassSystem,
    class_system,
    entry_point_names,
    entry_point_system,
    is_class_name,
)
from dslab.scenarios.errors import InputError
from dslab.scenarios.extensions import source_digest
from dslab.scenarios.faults import guess
from dslab.scenarios.input_files import file_names, is_folder
from dslab.sim.cache import content_key
from dslab.slam.factory import DUAL, SYSTEMS

VARIABLE = "DSLAB_SYSTEMS"
"""Environment variable with the folders of further descriptions, separated as in PATH."""
_NAME = re.compile(r"[A-Za-z0-9][\w.+@-]*")
_LAB = "lab@"
_COMMIT = re.compile(r"[0-9a-f]{7,40}")
_DUAL = re.compile(r"dual\((.*)\)")
_RECOVERY = "recovery="
_COMMA = re.compile(r",(?![^(]*\))")


@dataclass(frozen=True)
class OwnSystem:
    """One of the systems that come with the lab, by its name."""

    name: str


@dataclass(frozen=True)
class DualSystem:
    """Dual-SLAM over a system: ``dual(X)``, or ``dual(X, recovery=Y)`` with others for its recovery threads.

    Attributes:
        name: of it.
        forward: the system.
        recoveries: of the threads, in order; none for the forward one itself.
    """

    name: str
    forward: "System"
    recoveries: tuple["System", ...] = ()

    @property
    def parts(self) -> tuple["System", ...]:
        """What it is made of."""
        return (self.forward, *self.recoveries)


System = OwnSystem | ClassSystem | CommandSystem | DualSystem


def programs_of(system: System) -> list[CommandSystem]:
    """The programs that a system is or is made of."""
    if isinstance(system, DualSystem):
        return [program for part in system.parts for program in programs_of(part)]
    return [system] if isinstance(system, CommandSystem) else []


def check_startable(system: System) -> None:
    """Check that the programs of a system can be started. Raises InputError if not."""
    for program in programs_of(system):
        program.check()


def takes_real_time(system: System) -> bool:
    """Return True if it takes frames in real time: what runs beside it changes what it does."""
    return any(program.takes_real_time for program in programs_of(system))


@dataclass(frozen=True)
class Registry:
    """Systems by name; classes and descriptions are read when they are asked for.

    Attributes:
        files: descriptions of programs, by name.
        classes: entry points, by name.
        folders: of the descriptions.
    """

    files: dict[str, Path]
    classes: dict[str, EntryPoint] = field(default_factory=entry_point_names)
    folders: tuple[Path, ...] = (OWN_FOLDER,)

    @classmethod
    def open(cls, folders: Iterable[Path] = ()) -> "Registry":
        """List what there is.

        Args:
            folders: of further descriptions, beside ours and those of ``DSLAB_SYSTEMS``.

        Raises:
            InputError: a folder does not exist, or a name is given twice.
        """
        named = [Path(part) for part in os.environ.get(VARIABLE, "").split(os.pathsep) if part]
        places = tuple(dict.fromkeys([OWN_FOLDER, *named, *folders]))
        found = cls({}, folders=places)
        for folder in places:
            found._add(folder)
        return found

    def names(self) -> list[str]:
        """Every name: ours, then descriptions, then classes."""
        return [*SYSTEMS, *self.files, *self.classes]

    def find(self, name: str) -> System:
        """The system of a name, or a class that is named as ``module:Class``.

        ``base@0.2.0`` is a system of a release of this lab, ``base@019e78a`` of any commit of it;
        ``dual(orbslam3, recovery=ldso)`` is Dual-SLAM over any of them.

        Raises:
            InputError: there is none, or it is not valid.
        """
        if (dual := _DUAL.fullmatch(name.strip())) is not None:
            return self._dual(split_names(dual[1]))
        if name in SYSTEMS:
            return OwnSystem(name)
        if name in self.files:
            return CommandSystem(name, read_command_spec(self.files[name], self.folders), self.files[name])
        if name in self.classes:
            return entry_point_system(self.classes[name])
        if is_class_name(name):
            return class_system(name)
        if "@" in name and any(file.startswith(_LAB) for file in self.files):
            return self._earlier(name)
        known = self.names()
        remedy = f"give {guess(name, known)}one of {', '.join(known)}, or module:Class"
        raise InputError("--system", f"there is no system {name!r}", remedy)

    def find_all(self, names: Iterable[str]) -> dict[str, System]:
        """The systems of several names, by the names that they have in results.

        Raises:
            InputError: as :meth:`find`, or one is named twice.
        """
        found: dict[str, System] = {}
        for name in names:
            system = self.find(name)
            if system.name in found:
                raise InputError("--system", f"{system.name} is given twice", "name each once")
            found[system.name] = system
        return found

    def _dual(self, words: list[str]) -> DualSystem:
        """Dual-SLAM over the system of the first word, with those of the others for its recoveries."""
        forward, *others = words
        odd = [word for word in others if not word.startswith(_RECOVERY)]
        if odd or not forward:
            problem = f"{odd[0]!r} is no recovery" if odd else "dual() names no system"
            raise InputError("--system", problem, "write dual(base) or dual(base, recovery=ldso)")
        made = [self.find(forward), *(self.find(word.removeprefix(_RECOVERY).strip()) for word in others)]
        for system in made:
            if isinstance(system, DualSystem) or system.name in DUAL:
                problem = f"{system.name} has recoveries of its own"
                raise InputError("--system", problem, "name a system without, such as base")
        names = [made[0].name, *(_RECOVERY + system.name for system in made[1:])]
        return DualSystem(f"dual({','.join(names)})", made[0], tuple(made[1:]))

    def _earlier(self, name: str) -> CommandSystem:
        """A system of a release of this lab, or of a commit, which is run as the last release is."""
        system, _, version = name.partition("@")
        releases = [file for file in self.files if file.startswith(_LAB)]
        is_commit = _LAB + version not in releases
        if is_commit and not _COMMIT.fullmatch(version):
            known = ", ".join(file.removeprefix(_LAB) for file in releases)
            raise InputError("--system", f"there is no release {version!r}", f"give {known} or a commit")
        file = self.files[releases[-1] if is_commit else _LAB + version]
        spec = read_command_spec(file, self.folders)
        if is_commit:
            about = {"about": f"this lab at commit {version}", "environment": Environment(commit=version)}
            spec = spec.model_copy(update=about)
        elif system not in spec.systems:
            remedy = f"give one of {', '.join(f'{known}@{version}' for known in spec.systems)}"
            raise InputError("--system", f"there is no system {name!r}", remedy)
        if system != "lab":
            spec = spec.model_copy(update={"settings": {**spec.settings, "system": system}})
        return CommandSystem(name, spec, file)

    def _add(self, folder: Path) -> None:
        if not is_folder(folder):
            raise InputError(f"systems: {folder}", "no such folder", f"correct --systems or {VARIABLE}")
        for file in (folder / name for name in file_names(folder) if name.endswith(".yaml")):
            name = file.stem
            if not _NAME.fullmatch(name):
                raise InputError(str(file), "is no name of a system", "use letters, digits and . + - _ @")
            if name in self.names():
                raise InputError(str(file), f"the name {name} is taken", "rename the file")
            self.files[name] = file


def system_digest(system: System) -> str:
    """Hash of a class or a description, which changes with it; empty for our systems."""
    if isinstance(system, DualSystem):
        digests = [system_digest(part) for part in system.parts]
        return content_key(digests) if any(digests) else ""
    if isinstance(system, CommandSystem):
        return content_key(system.spec.model_dump(mode="json", exclude_defaults=True))
    return source_digest(system.make) if isinstance(system, ClassSystem) else ""


def split_names(names: str) -> list[str]:
    """The names in an option, which commas outside of brackets separate."""
    return [name.strip() for name in _COMMA.split(names)]
