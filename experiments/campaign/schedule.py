"""Which unit comes next: by index over all cells, to the budget of each or until its stopping rule is met.

The set of units run depends on the spec and on their records alone: a rule is asked at fixed numbers of
units, in the order of their index, never in that in which they happened to end.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from experiments.eq1.units import ThreadChoice, UnitSpec

Record = Mapping[str, Any]


class StoppingRule(Protocol):
    """When a cell has units enough."""

    def checkpoints(self, budget: int) -> Sequence[int]:
        """Numbers of units at which it is asked, increasing, all below the budget."""
        ...

    def is_met(self, records: Sequence[Record]) -> bool:
        """Whether these, the first units of a cell by index, are enough."""
        ...


class Experiment(Protocol):
    """What is asked of an experiment's spec."""

    @property
    def name(self) -> str: ...
    @property
    def content_hash(self) -> str: ...
    @property
    def threads(self) -> Sequence[ThreadChoice]: ...
    def cell_names(self) -> Sequence[str]: ...
    def units_of(self, cell: str) -> int: ...
    def unit(self, cell: str, index: int) -> UnitSpec: ...
    def as_yaml(self) -> str: ...


@dataclass
class _Cell:
    """A cell at work.

    Attributes:
        budget: the most units that it may have.
        gate: units that may be begun for now.
        begun: units handed out, or found done, counted without a gap from 0.
        done: records by index.
    """

    budget: int
    gate: int
    begun: int = 0
    done: dict[int, Record] = field(default_factory=dict)
    stopped: bool = False


class Schedule:
    """What is still to do of an experiment.

    Args:
        experiment: its spec.
        done: records that are there already.
        rule: when a cell has units enough; None runs every budget to its end.
    """

    def __init__(
        self,
        experiment: Experiment,
        done: Sequence[Record] = (),
        rule: StoppingRule | None = None,
    ) -> None:
        self._experiment = experiment
        self._rule = rule
        self._cells: dict[str, _Cell] = {}
        for name in experiment.cell_names():
            budget = experiment.units_of(name)
            self._cells[name] = _Cell(budget, self._next_gate(budget, 0))
        for record in done:
            self._cells[record["cell"]].done[record["index"]] = record
        for cell in self._cells.values():
            self._move_gate(cell)

    def next(self) -> UnitSpec | None:
        """The unit to begin now; None where there is none until others have ended."""
        best: tuple[int, str] | None = None
        for name, cell in self._cells.items():
            while cell.begun < cell.gate and cell.begun in cell.done:
                cell.begun += 1
            if cell.begun < cell.gate and (best is None or cell.begun < best[0]):
                best = (cell.begun, name)
        if best is None:
            return None
        index, name = best
        self._cells[name].begun += 1
        return self._experiment.unit(name, index)

    def finish(self, record: Record) -> None:
        """Take note of a unit that has ended."""
        cell = self._cells[record["cell"]]
        cell.done[record["index"]] = record
        self._move_gate(cell)

    @property
    def total(self) -> int:
        """Units in all: of a cell that has stopped those it has, of others their budget."""
        return sum(cell.gate if cell.stopped else cell.budget for cell in self._cells.values())

    @property
    def done(self) -> int:
        """Units of the total that have ended."""
        return sum(len(self._counted(cell)) for cell in self._cells.values())

    @property
    def complete(self) -> bool:
        """Whether nothing is left to do or to wait for."""
        return self.done == self.total

    def stopped_cells(self) -> dict[str, int]:
        """Cells that have met the rule, with the number of units at which they did."""
        return {name: cell.gate for name, cell in self._cells.items() if cell.stopped}

    def records(self) -> list[Record]:
        """Records of the units that count, by cell and index."""
        return [record for cell in self._cells.values() for record in self._counted(cell)]

    def _counted(self, cell: _Cell) -> list[Record]:
        end = cell.gate if cell.stopped else cell.budget
        return [cell.done[index] for index in sorted(cell.done) if index < end]

    def _move_gate(self, cell: _Cell) -> None:
        """Open the next stretch of a cell, or stop it, once all up to its gate is done."""
        while self._rule is not None and cell.gate < cell.budget and not cell.stopped:
            first = [cell.done.get(index) for index in range(cell.gate)]
            known = [record for record in first if record is not None]
            if len(known) < cell.gate:
                return
            if self._rule.is_met(known):
                cell.stopped = True
            else:
                cell.gate = self._next_gate(cell.budget, cell.gate)

    def _next_gate(self, budget: int, passed: int) -> int:
        if self._rule is None:
            return budget
        return next((n for n in self._rule.checkpoints(budget) if passed < n < budget), budget)
