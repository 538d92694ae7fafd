"""Snapshots: the whole state of a system in memory, from which any number of runs can branch."""

from copy import deepcopy
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar


class CountsFrames(Protocol):
    """A system that knows how many frames it has been given."""

    @property
    def frames(self) -> int: ...


System = TypeVar("System", bound=CountsFrames)


class Unchanging:
    """A value that is never written to after it is made: copies of a system share it."""

    def __deepcopy__(self, memo: dict) -> "Unchanging":
        return self


@dataclass(frozen=True)
class Snapshot(Generic[System]):
    """A system as it stood between two frames.

    Nothing that the system does later reaches the snapshot, and no branch reaches another: what can change
    (the arrays of the maps, the tracker, the buffer, random streams) is copied, what cannot (features, poses
    of past frames, events, settings) is shared.
    """

    _system: System

    @staticmethod
    def of(system: System) -> "Snapshot[System]":
        """Take a snapshot; the system goes on as if nothing had happened."""
        return Snapshot(deepcopy(system))

    def restore(self) -> System:
        """A system that goes on from here, bit for bit as the original did; each call gives another one."""
        return deepcopy(self._system)

    @property
    def frames(self) -> int:
        """Frames that the system had been given."""
        return self._system.frames
