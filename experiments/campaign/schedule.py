"""Order of units: by index, all cells of an index one after the other on one worker, and all of a world.

The cells of an index share their lead-in, and the replicates of a world its frames, which the worker has at
hand. Which worker runs a unit does not affect its record.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any, Protocol

from dslab.experiments.eq1.units import ThreadChoice, UnitSpec

Record = Mapping[str, Any]


class Experiment(Protocol):
    """Interface of an experiment's spec."""

    @property
    def name(self) -> str: ...
    @property
    def content_hash(self) -> str: ...
    @property
    def threads(self) -> Sequence[ThreadChoice]: ...
    @property
    def replicates_per_world(self) -> int: ...
    def cell_names(self) -> Sequence[str]: ...
    def units_of(self, cell: str) -> int: ...
    def unit(self, cell: str, index: int) -> UnitSpec: ...
    def as_yaml(self) -> str: ...


class UnitOrder(Protocol):
    """Interface of what decides which unit comes next."""

    @property
    def first_cells(self) -> int: ...
    @property
    def total(self) -> int: ...
    @property
    def done(self) -> int: ...
    @property
    def complete(self) -> bool: ...
    def next(self, worker: str = "") -> UnitSpec | None: ...
    def finish(self, record: Record) -> None: ...
    def records(self) -> list[Record]: ...


class Schedule:
    """Order of an experiment's remaining units.

    Args:
        experiment: its spec.
        done: existing records; those beyond the units of a cell do not count.
        last_first: begin with the last world, for a second machine that meets the first one in the middle.
    """

    def __init__(self, experiment: Experiment, done: Sequence[Record] = (), last_first: bool = False) -> None:
        self._experiment = experiment
        self._units = {cell: experiment.units_of(cell) for cell in experiment.cell_names()}
        self._done: dict[str, dict[int, Record]] = {cell: {} for cell in self._units}
        for record in done:
            self.finish(record)
        self._due: dict[int, deque[str]] = {}
        indices = range(max(self._units.values(), default=0))
        if last_first:
            indices = sorted(indices, key=self._world_of, reverse=True)
        for index in indices:
            cells = [cell for cell, n in self._units.items() if index < n and index not in self._done[cell]]
            if cells:
                self._due[index] = deque(cells)
        self._index_of: dict[str, int] = {}

    def next(self, worker: str = "") -> UnitSpec | None:
        """The next unit to start on a worker; None if all have been started.

        Args:
            worker: its name. It goes on with the index of its last unit, then with another of that world,
                then with one of a world, or else an index, that no other worker is at, then helps another.
        """
        index = self._index_of.get(worker)
        if index not in self._due:
            index = self._next_index(worker)
            if index is None:
                return None
            self._index_of[worker] = index
        cell = self._due[index].popleft()
        if not self._due[index]:
            del self._due[index]
        return self._experiment.unit(cell, index)

    def _next_index(self, worker: str) -> int | None:
        at = {index for other, index in self._index_of.items() if other != worker}
        worlds, own = set(map(self._world_of, at)), self._world_of(self._index_of.get(worker, -1))
        free = [index for index in self._due if index not in at]
        here = (index for index in free if self._world_of(index) == own)
        elsewhere = (index for index in free if self._world_of(index) not in worlds)
        return next(chain(here, elsewhere, free, self._due), None)

    def _world_of(self, index: int) -> int:
        return index // self._experiment.replicates_per_world

    def finish(self, record: Record) -> None:
        """Add the record of a unit that has ended."""
        if record["index"] < self._units[record["cell"]]:
            self._done[record["cell"]][record["index"]] = record

    @property
    def first_cells(self) -> int:
        """Number of cells with which it begins: all."""
        return len(self._units)

    @property
    def total(self) -> int:
        """Number of units."""
        return sum(self._units.values())

    @property
    def done(self) -> int:
        """Number of units that have ended."""
        return sum(map(len, self._done.values()))

    @property
    def complete(self) -> bool:
        """True if all units have ended."""
        return self.done == self.total

    def records(self) -> list[Record]:
        """Records of the units that have ended, by cell and index."""
        return [done[index] for done in self._done.values() for index in sorted(done)]
