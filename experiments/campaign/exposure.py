"""Does the stress of units act? Of an experiment before it runs, and of tables that do not say."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dslab.experiments.campaign.folder import read_rows, rewrite_table
from dslab.experiments.eq1.records import SHAM
from dslab.experiments.eq1.spec import ExperimentSpec
from dslab.scenarios.errors import InputError

Row = dict[str, Any]
Progress = Callable[[str, int, int], None]


DRAWN_WORLDS = 10
"""Worlds of a trial draw: with fewer in a cell nothing is tested."""
LEAST_EXPOSED = 0.9
"""Share of a cell's draws in which its stress should act."""


@dataclass(frozen=True)
class Drawn:
    """A trial draw of one cell.

    Attributes:
        cell: its name.
        acted, drawn: sequences whose stress acts, and all that were drawn.
    """

    cell: str
    acted: int
    drawn: int

    @property
    def is_exposed(self) -> bool:
        """True if its stress acts often enough."""
        return self.acted >= LEAST_EXPOSED * self.drawn


def draw_exposure(spec: ExperimentSpec, progress: Progress = lambda step, done, total: None) -> list[Drawn]:
    """Draw the first sequence of the first worlds of every cell with a stress, and see whether it acts.

    Nothing is drawn of an experiment with fewer worlds: whatever acts, it tests nothing.

    Args:
        spec: of the experiment.
        progress: called with a name, sequences drawn and sequences to draw.
    """
    from dslab.sim.stress_check import stress_acts

    cells = {cell.image: name for name, cell in spec.cells.items() if cell.dose is not None}
    worlds = range(DRAWN_WORLDS if spec.worlds >= DRAWN_WORLDS else 0)
    acted = dict.fromkeys(cells.values(), 0)
    for world in worlds:
        for number, cell in enumerate(cells.values()):
            acted[cell] += stress_acts(spec.unit(cell, world * spec.replicates_per_world).scenario)
            progress("drawing", world * len(cells) + number + 1, len(worlds) * len(cells))
    return [Drawn(cell, acted[cell], len(worlds)) for cell in acted] if worlds else []


@dataclass(frozen=True)
class Exposure:
    """What a table says of its units with a stress.

    Attributes:
        acted, idle, unknown: units whose stress acted, did not act, and of which nobody can say.
        looked: sequences whose plan was made again for it.
    """

    acted: int
    idle: int
    unknown: int
    looked: int


def fill_exposed(folder: Path, progress: Progress = lambda step, done, total: None) -> Exposure:
    """Fill the column ``exposed`` of an exported table where it is null, and write the table anew.

    A unit with a view overlap about its stress was exposed, and so was every other unit of its sequence under
    that stress. Of the rest the plan is made again. Where the code at hand draws another unit, it stays
    unknown.

    Args:
        folder: with an exported table alone.
        progress: called with a name, plans made and plans to make.

    Raises:
        InputError: the folder has no such table, or a ledger beside it, or cannot be written.
    """
    spec, rows = read_rows(folder)
    stressed = [row for row in rows if row["kind"] != SHAM]
    known = {_sequence(row): _said(row) for row in stressed if _said(row) is not None}
    left = {_sequence(row): row for row in stressed if _sequence(row) not in known}
    for done, (sequence, row) in enumerate(_by_world(left)):
        known[sequence] = _seen(spec, row)
        progress("planning", done + 1, len(left))
    for row in stressed:
        row["exposed"] = known[_sequence(row)]
    rewrite_table(folder, spec, rows)
    counts = [[row["exposed"] for row in stressed].count(value) for value in (True, False, None)]
    return Exposure(*counts, looked=len(left))


def _said(row: Row) -> bool | None:
    """What a row itself says; the overlap is computed about a stress that acts."""
    if row["exposed"] is not None:
        return row["exposed"]
    return True if row["view_overlap"] is not None else None


def _sequence(row: Row) -> tuple[Any, ...]:
    """Path and stress, the same for replicates and systems."""
    place = row["index"] if row["sequence_seed"] is None else row["sequence_seed"]
    return row["base"], row["kind"], row["severity"], row["world_seed"], place


def _by_world(rows: dict[tuple[Any, ...], Row]) -> Iterator[tuple[tuple[Any, ...], Row]]:
    """World after world: one that was built serves all of its sequences."""
    yield from sorted(rows.items(), key=lambda item: (item[1]["world_seed"], item[1]["cell"]))


def _seen(spec: ExperimentSpec, row: Row) -> bool | None:
    from dslab.sim.stress_check import stress_acts

    try:
        unit = spec.unit(row["cell"], row["index"])
    except InputError:
        return None
    return stress_acts(unit.scenario) if unit.unit_id == row["unit_id"] else None
