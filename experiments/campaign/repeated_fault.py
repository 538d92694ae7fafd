"""Detection of a fault that lies with the machine and not with a unit: it repeats on every unit."""

import re

from dslab.experiments.eq1.units import UnitSpec
from dslab.scenarios.errors import MachineError

_ALIKE = 2
_VARYING = re.compile(r"[0-9a-f]{8,}|[0-9.]+")
"""Hashes and measured numbers, in which messages of one fault differ."""


class RepeatedFault:
    """Infrastructure errors of one kind since the last success.

    They count as a fault of the machine once more units have failed alike than were under way at once, which
    may share a passing fault. Before any success it must be a unit of every cell too; after one, units count
    only if their cell has had success, so that a cell whose units always fail is left to the tries of each.

    Args:
        cells: number of cells.
        proven: cells in which a unit has ended without an infrastructure error.
    """

    def __init__(self, cells: int, proven: set[str]) -> None:
        self._cells = cells
        self._proven = proven
        self._kind = ""
        self._units: dict[str, str] = {}

    def success(self, cell: str) -> None:
        """Note that a unit has ended without an infrastructure error."""
        self._proven.add(cell)
        self._units.clear()

    def failure(self, unit: UnitSpec, message: str, workers: int) -> None:
        """Note an infrastructure error.

        Args:
            unit: the failed unit.
            message: of the error.
            workers: largest number of units under way at once.

        Raises:
            MachineError: the fault is the machine's.
        """
        if self._proven and unit.cell not in self._proven:
            return
        kind = _VARYING.sub("#", message)
        if kind != self._kind:
            self._kind = kind
            self._units.clear()
        self._units[unit.unit_id] = unit.cell
        everywhere = bool(self._proven) or len(set(self._units.values())) == self._cells
        if everywhere and len(self._units) >= workers + _ALIKE:
            problem = f"the last {len(self._units)} units ended in the same error: {message}"
            raise MachineError("the run has stopped", problem, "mend it and run the same command again")
