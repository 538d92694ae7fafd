"""Replay of one unit of a claim's experiment, compared with its rows."""

from pathlib import Path

from dslab.experiments.claims.folder import read_claim
from dslab.experiments.claims.kinds import KINDS, Unit
from dslab.experiments.claims.runner import measured
from dslab.scenarios.errors import InputError


def replay_claim(
    folder: Path, name: str, recording: Path | None = None
) -> tuple[Unit, tuple[str, ...], bool]:
    """Measure a unit again.

    Args:
        folder: of the experiment, with its ledger or with only the exported table.
        name: number of the unit.
        recording: file for its recording; None for none.

    Returns:
        The unit; the columns in which its rows differ from those of the folder; whether there are any.

    Raises:
        InputError: no such folder or unit, or units of its kind are not recorded.
    """
    claimed = read_claim(folder)
    kind, spec = KINDS[claimed.spec.kind], claimed.spec
    units = kind.units(spec)
    if not name.isdigit() or int(name) >= len(units):
        raise InputError(name, "is no unit", f"give a number from 0 to {len(units) - 1}")
    unit = units[int(name)]
    if recording is not None:
        if kind.record is None:
            raise InputError("--rerun", f"units of kind {spec.kind} are not recorded", "leave it out")
        kind.record(spec, unit, recording)
    rows = measured(kind.measure, spec, unit)["rows"]
    known = [row for row in claimed.rows if row["unit"] == int(name)]
    if known and len(known) != len(rows):
        return unit, ("number of rows",), True
    changed = [key for new, old in zip(rows, known, strict=False) for key in new if new[key] != old.get(key)]
    return unit, tuple(dict.fromkeys(changed)), bool(known)
