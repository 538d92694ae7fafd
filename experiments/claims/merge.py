"""Bring the units of a claim's experiment together that several machines, or an exported table, hold."""

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from dslab.experiments.campaign.folder import SPEC_FILE, claim_folder
from dslab.experiments.campaign.merge import Merged
from dslab.experiments.claims.folder import ended_units, owner_of, unit_key
from dslab.experiments.claims.kinds import KINDS
from dslab.experiments.claims.loading import load_claim
from dslab.experiments.jobs.ledger import LEDGER_FILE, Ledger, Row, sole_driver
from dslab.scenarios.errors import InputError
from dslab.sim.io.folders import write_file


def merge_claims(folder: Path, sources: Sequence[Path]) -> Merged:
    """Add the units of other folders of the same experiment to the ledger of a folder; all of them or none.

    Args:
        folder: absent, empty, or of the same experiment; it is created.
        sources: each with a ledger, or with only ``spec.yaml`` and an exported table.

    Raises:
        InputError: they are of different experiments or the folder is in use, or a unit has different rows.
    """
    specs = [load_claim(source) for source in sources]
    spec = load_claim(folder) if (folder / LEDGER_FILE).exists() else specs[0]
    for source, other in zip(sources, specs, strict=True):
        if other.content_hash != spec.content_hash:
            problem = f"is of another experiment than {folder}: {other.name}, or with other fields"
            raise InputError(str(source), problem, "merge folders of one spec")
    # Of those that were run with --worlds, the one with most.
    spec = max([spec, *specs], key=lambda each: each.worlds)
    claim_folder(folder)
    with sole_driver(folder), Ledger.open(folder, owner_of(spec)) as ledger:
        held = {row["unit"]: row for row in ledger.rows()}
        new, known = {}, 0
        for source in sources:
            for row in ended_units(source):
                same = held.get(row["unit"]) or new.get(row["unit"])
                if same is None:
                    new[row["unit"]] = row
                elif _told(same) == _told(row):
                    known += 1
                else:
                    problem = f"{row['unit']} has other rows in {folder} or another source"
                    raise InputError(str(source), problem, "leave the wrong folder out")
        ledger.add(*new.values())
        write_file(folder / SPEC_FILE, partial(Path.write_text, data=spec.as_yaml(), encoding="utf-8"))
    units = {unit_key(unit) for unit in KINDS[spec.kind].units(spec)}
    return Merged(len(new), known, len(units & (set(held) | set(new))), len(units))


def _told(row: Row) -> str:
    """What the rows of a unit say; an exported table knows nothing of columns that are empty in all."""
    rows = [{name: value for name, value in of.items() if value is not None} for of in row["rows"]]
    return json.dumps(rows, sort_keys=True)
