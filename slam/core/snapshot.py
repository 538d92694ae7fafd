"""Snapshots: copies of a system's whole state, from which runs can branch."""

from copy import deepcopy
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar


class CountsFrames(Protocol):
    """A system that counts its frames."""

    @property
    def frames(self) -> int: ...


System = TypeVar("System", bound=CountsFrames)


class Immutable:
    """An immutable value: copies of a system share it."""

    def __deepcopy__(self, memo: dict) -> "Immutable":
        return self


@dataclass(frozen=True)
class Snapshot(Generic[System]):
    """State of a system between two frames.

    The snapshot, the system and all branches are independent: mutable parts (the arrays of the maps, the
    tracker, the buffer, random streams) are copied; immutable parts (features, poses of past frames, events,
    settings) are shared.
    """

    _system: System

    @staticmethod
    def of(system: System) -> "Snapshot[System]":
        """Take a snapshot; the system itself is not affected."""
        return Snapshot(deepcopy(system))

    def restore(self) -> System:
        """Return a new system that continues from here, bit for bit as the original did."""
        return deepcopy(self._system)

    @property
    def frames(self) -> int:
        """Number of frames that the system had processed."""
        return self._system.frames
