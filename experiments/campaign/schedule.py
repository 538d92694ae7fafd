"""Order of units: by index, all cells of an index one after the other on one worker, and all of a world.

The cells of an index share their lead-in, and the replicates of a world its frames, which the worker has at
hand. Which worker runs a unit does not affect its record.
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Mapping
from itertools import chain
from typing import Any

from dslab.experiments.eq1.spec import ExperimentSpec
from dslab.experiments.eq1.units import UnitSpec

Record = Mapping[str, Any]


class UnitOrder(ABC):
    """What decides which unit comes next, with the records of those that have ended.

    Attributes:
        first_cells: number of cells with which it begins.
        total: number of units.
    """

    first_cells: int
    total: int

    def __init__(self) -> None:
        self._ended: dict[Any, Record] = {}

    @abstractmethod
    def next(self, worker: str = "") -> UnitSpec | None:
        """The next unit to start on a worker, by its name; None if there is none now."""

    @abstractmethod
    def finish(self, record: Record) -> None:
        """Add the record of a unit that has ended."""

    @property
    def done(self) -> int:
        """Number of units that have ended."""
        return len(self._ended)

    @property
    def complete(self) -> bool:
        """True if all units have ended."""
        return self.done == self.total

    def records(self) -> list[Record]:
        """Records of the units that have ended, in order."""
        return [self._ended[key] for key in sorted(self._ended)]


class Schedule(UnitOrder):
    """Order of an experiment's remaining units.

    A worker goes on with the index of its last unit, then with another of that world, then with one of a
    world, or else an index, that no other worker is at, then helps another.

    Args:
        experiment: its spec.
        done: existing records; those beyond the units of a cell do not count.
        last_first: begin with the last world, for a second machine that meets the first one in the middle.
    """

    def __init__(
        self, experiment: ExperimentSpec, done: Iterable[Record] = (), last_first: bool = False
    ) -> None:
        super().__init__()
        self._experiment = experiment
        self._units = {cell: experiment.units_of(cell) for cell in experiment.cell_names()}
        self._place = {cell: place for place, cell in enumerate(self._units)}
        self.first_cells, self.total = len(self._units), sum(self._units.values())
        for record in done:
            self.finish(record)
        self._due: dict[int, deque[str]] = {}
        indices = range(max(self._units.values(), default=0))
        for index in sorted(indices, key=self._world_of, reverse=True) if last_first else indices:
            cells = [
                c for c, n in self._units.items() if index < n and (self._place[c], index) not in self._ended
            ]
            if cells:
                self._due[index] = deque(cells)
        self._index_of: dict[str, int] = {}

    def next(self, worker: str = "") -> UnitSpec | None:
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

    def finish(self, record: Record) -> None:
        cell, index = record["cell"], record["index"]
        if index < self._units[cell]:
            self._ended[self._place[cell], index] = record

    def _next_index(self, worker: str) -> int | None:
        at = {index for other, index in self._index_of.items() if other != worker}
        worlds, own = set(map(self._world_of, at)), self._world_of(self._index_of.get(worker, -1))
        free = [index for index in self._due if index not in at]
        here = (index for index in free if self._world_of(index) == own)
        elsewhere = (index for index in free if self._world_of(index) not in worlds)
        return next(chain(here, elsewhere, free, self._due), None)

    def _world_of(self, index: int) -> int:
        return index // self._experiment.replicates_per_world
