"""The folder of a claim's experiment: ``spec.yaml``, the ledger with a row per unit, once reported all rows.

The exported table has a digest over its rows, and that of the spec beside it, as a table of Eq. 1 has.
"""

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dslab.experiments.campaign.folder import open_parquet, rows_digest, spec_digest
from dslab.experiments.claims.kinds import KINDS
from dslab.experiments.claims.loading import load_claim
from dslab.experiments.claims.spec import ClaimSpec, Row, Unit
from dslab.experiments.jobs.ledger import LEDGER_FILE, Ledger, Owner
from dslab.experiments.runs.provenance import release
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_given
from dslab.sim.io.folders import write_file

if TYPE_CHECKING:
    import pyarrow as pa

TABLE_FILE = "table.parquet"
OF_UNIT = ("unit", "rows", "wall_s", "code", "commit")
"""Columns of the ledger: the unit as JSON, its rows, and where they come from."""
_MOST_ROWS = 5_000_000
_REPORT = "write it anew by `dslab experiment report` from its ledger"


@dataclass(frozen=True)
class Claimed:
    """What the folder of a claim's experiment holds.

    Attributes:
        spec: of the experiment.
        rows: of all units that have ended, in the order of the units.
        done, total: units that have ended, and all units.
        messages: each once, of the infrastructure errors in which units without rows have ended.
        wall_s: worker time of the units; None of an exported table.
        codes: hashes of the sources that made the rows.
    """

    spec: ClaimSpec
    rows: list[Row]
    done: int
    total: int
    messages: tuple[str, ...] = ()
    wall_s: float | None = None
    codes: tuple[str, ...] = ()


def unit_key(unit: Unit) -> str:
    """The unit as text, independent of the order of its keys."""
    return json.dumps(unit, sort_keys=True)


def owner_of(spec: ClaimSpec) -> Owner:
    """The experiment as the owner of a ledger, whose rows are in the order of its units."""
    places = {unit_key(unit): place for place, unit in enumerate(KINDS[spec.kind].units(spec))}

    def fault(row: Row) -> str | None:
        differing = set(row) ^ set(OF_UNIT)
        return f"missing or unknown columns: {', '.join(sorted(differing))}" if differing else None

    def order(row: Row) -> tuple[int, str]:
        return places.get(row["unit"], len(places)), row["unit"]

    return Owner({"spec": f"{spec.name} {spec.content_hash[:16]}"}, ("unit",), order, fault)


def read_claim(folder: Path) -> Claimed:
    """Read the rows of an experiment, also during a run.

    Args:
        folder: with a ledger, or with only spec and exported table.

    Raises:
        InputError: it is not such a folder, or its rows are damaged.
    """
    spec = load_claim(folder)
    keys = [unit_key(unit) for unit in KINDS[spec.kind].units(spec)]
    if not is_given(folder / LEDGER_FILE) and is_given(folder / TABLE_FILE):
        rows = _exported(folder)
        done = len({row["unit"] for row in rows} & set(range(len(keys))))
        return Claimed(spec, rows, done, len(keys), codes=_codes(rows))
    with Ledger.open(folder, owner_of(spec), read_only=True) as ledger:
        stored, errors = ledger.rows(), ledger.errors()
    ended = {row["unit"]: row for row in stored}
    rows = []
    for place, key in enumerate(keys):
        if key not in ended:
            continue
        of = ended[key]
        own = _told_of(json.loads(key))
        about = {"code": of["code"], "commit": of["commit"]}
        rows += [{"unit": place, **own, **row, **about} for row in of["rows"]]
    return Claimed(
        spec,
        rows,
        done=sum(key in ended for key in keys),
        total=len(keys),
        messages=tuple(dict.fromkeys(e["message"] for e in errors if e["unit"] not in ended)),
        wall_s=sum(row["wall_s"] for row in stored),
        codes=_codes(stored),
    )


def ended_units(folder: Path) -> list[Row]:
    """The units that have ended, each as a row of a ledger; of an exported table without their times.

    Raises:
        InputError: it is not a folder of an experiment, or its rows are damaged.
    """
    spec = load_claim(folder)
    if is_given(folder / LEDGER_FILE) or not is_given(folder / TABLE_FILE):
        with Ledger.open(folder, owner_of(spec), read_only=True) as ledger:
            return ledger.rows()
    units, found = KINDS[spec.kind].units(spec), {}
    for row in _exported(folder):
        unit = units[row["unit"]]
        own = {"unit", "code", "commit", *_told_of(unit)}
        of = {"unit": unit_key(unit), "rows": [], "wall_s": 0.0, "code": row["code"], "commit": row["commit"]}
        told = {name: value for name, value in row.items() if name not in own}
        found.setdefault(row["unit"], of)["rows"].append(told)
    return list(found.values())


def _told_of(unit: Unit) -> Unit:
    """What of a unit is in its rows."""
    return {name: value for name, value in unit.items() if not isinstance(value, dict | list)}


def arrow_table(rows: list[Row]) -> "pa.Table":
    """The rows as a table with every column that one of them has; its types follow from the values."""
    import pyarrow as pa

    names = dict.fromkeys(name for row in rows for name in row)
    return pa.table({name: pa.array([row.get(name) for row in rows]) for name in names})


def write_table(folder: Path, claimed: Claimed) -> None:
    """Write ``table.parquet``; the file depends on spec and rows only.

    Raises:
        InputError: it cannot be written.
    """
    import pyarrow.parquet as pq

    table = arrow_table(claimed.rows)
    about = {
        "experiment": claimed.spec.name,
        "spec_digest": spec_digest(folder),
        "release": release(),
        "digest": rows_digest(table.to_pylist()),
    }
    told = table.replace_schema_metadata(about)
    write_file(folder / TABLE_FILE, partial(_write, table=told, write=pq.write_table))


def _write(path: Path, table: "pa.Table", write: Any) -> None:
    write(table, path, write_page_checksum=True, compression="zstd")


def _exported(folder: Path) -> list[Row]:
    """The rows of an exported table, as they were written beside the spec that is still there."""
    path = folder / TABLE_FILE
    with open_parquet(path) as file:
        about = dict(file.schema_arrow.metadata or {})
        if about.get(b"spec_digest") != spec_digest(folder).encode():
            raise InputError(str(path), "was exported with another spec.yaml than stands beside it", _REPORT)
        if file.metadata.num_rows > _MOST_ROWS:
            raise InputError(str(path), f"has {file.metadata.num_rows} rows, too many to read", _REPORT)
        rows = file.read().to_pylist()
    if about.get(b"digest") != rows_digest(rows).encode():
        raise InputError(str(path), "is damaged: its rows are not those that were written", _REPORT)
    return rows


def _codes(rows: list[Row]) -> tuple[str, ...]:
    return tuple(sorted({row["code"] for row in rows if row["code"]}))
