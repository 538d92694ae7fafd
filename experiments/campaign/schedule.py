"""Order of units: by index over all cells, to each cell's budget or until its stopping rule is met.

The set of units run depends only on the spec and their records: a rule is evaluated at fixed numbers of
units, in the order of their index, not in the order in which they end.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from experiments.eq1.units import ThreadChoice, UnitSpec

Record = Mapping[str, Any]


class StoppingRule(Protocol):
    """Condition under which a cell has enough units."""

    def checkpoints(self, budget: int) -> Sequence[int]:
        """Numbers of units at which it is evaluated, increasing, all below the budget."""
        ...

    def is_met(self, records: Sequence[Record]) -> bool:
        """True if these, the first units of a cell by index, are enough."""
        ...


class Experiment(Protocol):
    """Interface of an experiment's spec."""

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
    """Progress of a cell.

    Attributes:
        budget: largest number of units.
        gate: number of units that may be started for now.
        started: number of units started or found done, without a gap from 0.
        done: records by index.
    """

    budget: int
    gate: int
    started: int = 0
    done: dict[int, Record] = field(default_factory=dict)
    stopped: bool = False


class Schedule:
    """Order of an experiment's remaining units.

    Args:
        experiment: its spec.
        done: existing records.
        rule: stopping rule; None runs every budget to its end.
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
        """The next unit to start; None if there is none until others have ended."""
        best: tuple[int, str] | None = None
        for name, cell in self._cells.items():
            while cell.started < cell.gate and cell.started in cell.done:
                cell.started += 1
            if cell.started < cell.gate and (best is None or cell.started < best[0]):
                best = (cell.started, name)
        if best is None:
            return None
        index, name = best
        self._cells[name].started += 1
        return self._experiment.unit(name, index)

    def finish(self, record: Record) -> None:
        """Add the record of a unit that has ended."""
        cell = self._cells[record["cell"]]
        cell.done[record["index"]] = record
        self._move_gate(cell)

    @property
    def total(self) -> int:
        """Number of units: the present ones of stopped cells, the budget of others."""
        return sum(cell.gate if cell.stopped else cell.budget for cell in self._cells.values())

    @property
    def done(self) -> int:
        """Number of units of the total that have ended."""
        return sum(len(self._counted(cell)) for cell in self._cells.values())

    @property
    def complete(self) -> bool:
        """True if all units have ended."""
        return self.done == self.total

    def stopped_cells(self) -> dict[str, int]:
        """Cells that met the rule, with their number of units at that point."""
        return {name: cell.gate for name, cell in self._cells.items() if cell.stopped}

    def records(self) -> list[Record]:
        """Records of the units of the total, by cell and index."""
        return [record for cell in self._cells.values() for record in self._counted(cell)]

    def _counted(self, cell: _Cell) -> list[Record]:
        end = cell.gate if cell.stopped else cell.budget
        return [cell.done[index] for index in sorted(cell.done) if index < end]

    def _move_gate(self, cell: _Cell) -> None:
        """Advance the gate of a cell, or stop the cell, once all units up to the gate are done."""
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
