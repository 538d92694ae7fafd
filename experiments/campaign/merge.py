"""Bring the units of one experiment together that several machines, or an exported table, hold."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dslab.experiments.campaign.folder import claim_folder, open_ledger, read_rows, read_spec, write_spec
from dslab.experiments.campaign.runner import check_units, is_infrastructure_error
from dslab.experiments.eq1.records import reproduced
from dslab.experiments.jobs.ledger import LEDGER_FILE, sole_driver
from dslab.scenarios.errors import InputError


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
    specs = [read_spec(source) for source in sources]
    spec = read_spec(folder) if (folder / LEDGER_FILE).exists() else specs[0]
    for source, other in zip(sources, specs, strict=True):
        if other.content_hash != spec.content_hash:
            problem = f"is of another experiment than {folder}: {other.name}, or with other fields"
            raise InputError(str(source), problem, "merge folders of one spec")
    # Of those that were run with --worlds, the one with most.
    spec = max([spec, *specs], key=lambda each: each.worlds)
    claim_folder(folder)
    with sole_driver(folder), open_ledger(folder, spec) as ledger:
        held = {row["unit_id"]: row for row in ledger.rows()}
        new, known = {}, 0
        for source in sources:
            _, rows = read_rows(source)
            rows = [row for row in rows if not is_infrastructure_error(row)]
            check_units(spec, rows, source)
            for row in rows:
                same = held.get(row["unit_id"]) or new.get(row["unit_id"])
                if same is None:
                    new[row["unit_id"]] = row
                elif reproduced(same) == reproduced(row):
                    known += 1
                else:
                    problem = (
                        f"{row['cell']}:{row['index']} has another outcome in {folder} or another source"
                    )
                    remedy = "replay it with `dslab experiment replay`, and leave the wrong folder out"
                    raise InputError(str(source), problem, remedy)
        ledger.add(*new.values())
        write_spec(folder, spec)
        done = len(held) + len(new)
    return Merged(len(new), known, done, sum(spec.units_of(cell) for cell in spec.cell_names()))
