"""Bring the units of a claim's experiment together that several machines, or an exported table, hold."""

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from dslab.experiments.campaign.folder import SPEC_FILE, claim_folder
from dslab.experiments.campaign.merge import Merged, add_units, common_spec
from dslab.experiments.claims.folder import ended_units, owner_of, unit_key
from dslab.experiments.claims.kinds import KINDS
from dslab.experiments.claims.loading import load_claim
from dslab.experiments.jobs.ledger import Ledger, Row, sole_driver
from dslab.sim.io.folders import write_file


def merge_claims(folder: Path, sources: Sequence[Path]) -> Merged:
    """Add the units of other folders of the same experiment to the ledger of a folder; all of them or none.

    Args:
        folder: absent, empty, or of the same experiment; it is created.
        sources: each with a ledger, or with only ``spec.yaml`` and an exported table.

    Raises:
        InputError: they are of different experiments or the folder is in use, or a unit has different rows.
    """
    spec = common_spec(folder, sources, load_claim)
    claim_folder(folder)
    with sole_driver(folder), Ledger.open(folder, owner_of(spec)) as ledger:
        held, new, known = add_units(
            ledger, folder, sources, ended_units, "unit", _told, lambda row: row["unit"]
        )
        write_file(folder / SPEC_FILE, partial(Path.write_text, data=spec.as_yaml(), encoding="utf-8"))
    units = {unit_key(unit) for unit in KINDS[spec.kind].units(spec)}
    return Merged(len(new), known, len(units & (held | new)), len(units))


def _told(row: Row) -> str:
    """What the rows of a unit say; an exported table knows nothing of columns that are empty in all."""
    rows = [{name: value for name, value in of.items() if value is not None} for of in row["rows"]]
    return json.dumps(rows, sort_keys=True)
