"""Bring the units of one experiment together that several machines, or an exported table, hold."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from dslab.experiments.campaign.folder import claim_folder, open_ledger, read_rows, read_spec, write_spec
from dslab.experiments.campaign.runner import check_units, is_infrastructure_error
from dslab.experiments.eq1.records import reproduced
from dslab.experiments.jobs.ledger import LEDGER_FILE, Ledger, Row, sole_driver
from dslab.scenarios.errors import InputError

Spec = TypeVar("Spec", bound=Any)


@dataclass(frozen=True)
class Merged:
    """What a merge has done.

    Attributes:
        added: units that the folder lacked.
        known: units that it had already, the same in every column but those of cost and of the code.
        done, total: units that it holds now, and all units.
    """

    added: int
    known: int
    done: int
    total: int


def merge(folder: Path, sources: Sequence[Path]) -> Merged:
    """Add the units of other folders of the same experiment to the ledger of a folder; all of them or none.

    Units that were given up for infrastructure errors are left out: a run tries them again.

    Args:
        folder: absent, empty, or of the same experiment; it is created.
        sources: each with a ledger, or with only ``spec.yaml`` and an exported table.

    Raises:
        InputError: they are of different experiments or the folder is in use, the code at hand draws other
            units, or the same unit has different outcomes.
    """
    spec = common_spec(folder, sources, read_spec)

    def units_in(source: Path) -> list[Row]:
        rows = [row for row in read_rows(source)[1] if not is_infrastructure_error(row)]
        check_units(spec, rows, source)
        return rows

    claim_folder(folder)
    with sole_driver(folder), open_ledger(folder, spec) as ledger:
        held, new, known = add_units(
            ledger,
            folder,
            sources,
            units_in,
            "unit_id",
            reproduced,
            lambda row: f"{row['cell']}:{row['index']}",
        )
        write_spec(folder, spec)
    total = sum(spec.units_of(cell) for cell in spec.cell_names())
    return Merged(len(new), known, len(held | new), total)


def common_spec(folder: Path, sources: Sequence[Path], read: Callable[[Path], Spec]) -> Spec:
    """The spec of folders of one experiment; of those that were run with ``--worlds``, that with most.

    Raises:
        InputError: they are of different experiments.
    """
    specs = [read(source) for source in sources]
    spec = read(folder) if (folder / LEDGER_FILE).exists() else specs[0]
    for source, other in zip(sources, specs, strict=True):
        if other.content_hash != spec.content_hash:
            problem = f"is of another experiment than {folder}: {other.name}, or with other fields"
            raise InputError(str(source), problem, "merge folders of one spec")
    return max([spec, *specs], key=lambda each: each.worlds)


def add_units(
    ledger: Ledger,
    folder: Path,
    sources: Sequence[Path],
    units_in: Callable[[Path], list[Row]],
    key: str,
    outcome: Callable[[Row], Any],
    told: Callable[[Row], str],
) -> tuple[set[str], set[str], int]:
    """Add the units of folders to a ledger, all of them or none.

    Args:
        ledger, folder: of the experiment.
        sources: folders.
        units_in: rows of the units that a folder holds.
        key: column that names a unit.
        outcome: what of a unit must be the same wherever it is held.
        told: how a unit is named to a user.

    Returns:
        Names of the units that the ledger held and of those that were added, and how many were known.

    Raises:
        InputError: a unit has different outcomes.
    """
    held = {row[key]: row for row in ledger.rows()}
    new, known = {}, 0
    for source in sources:
        for row in units_in(source):
            same = held.get(row[key]) or new.get(row[key])
            if same is None:
                new[row[key]] = row
            elif outcome(same) == outcome(row):
                known += 1
            else:
                problem = f"{told(row)} has another outcome in {folder} or another source"
                remedy = "replay it with `dslab experiment replay`, and leave the wrong folder out"
                raise InputError(str(source), problem, remedy)
    ledger.add(*new.values())
    return set(held), set(new), known
