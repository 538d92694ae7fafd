"""The folder of an experiment: ``spec.yaml``, ``ledger.sqlite`` and, once exported, ``units.parquet``.

The exported table has a digest over its rows, and that of the spec beside it.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dslab.experiments.eq1.record_table import data_frame, record_fault
from dslab.experiments.eq1.records import ColumnType, columns
from dslab.experiments.eq1.spec import ExperimentSpec, read_spec_file, validated
from dslab.experiments.jobs.ledger import LEDGER_FILE, LOCK_FILE, Ledger, Owner, Row
from dslab.experiments.runs.provenance import release
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import SETTINGS_BYTES, is_given, open_file, read_bytes
from dslab.sim.io.folders import unwritable, write_file
from dslab.sim.unfinished import sweep

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow.parquet as pq

SPEC_FILE = "spec.yaml"
TABLE_FILE = "units.parquet"
ERRORS_FILE = "infrastructure_errors.parquet"
ERROR_COLUMNS: dict[str, ColumnType] = {
    "unit_id": "text", "cell": "text", "index": "int", "attempt": "int", "at": "text", "worker": "text",
    "message": "text", "report": "text",
}  # fmt: skip
_MOST_ERRORS = 100
"""Of a unit, which few runs try more than a few times: more rows are no table of errors."""
_ARROW = {"bool": "bool_", "int": "int64", "float": "float64", "text": "string"}
_MEND = (
    "add --rerun-damaged to `dslab experiment run`, which runs damaged units again, or choose a new folder"
)
_EXPORT = "export it anew from its ledger, by the version that wrote it"


def owner_of(experiment: ExperimentSpec) -> Owner:
    """The experiment as the owner of a ledger, whose rows are records in the order of its cells."""
    cells = {cell: place for place, cell in enumerate(experiment.cell_names())}
    threads = len(experiment.threads)
    names = set(columns(threads))

    def fault(row: Row) -> str | None:
        if differing := set(row) ^ names:
            return f"missing or unknown columns: {', '.join(sorted(differing))}"
        if row["cell"] not in cells or row["experiment"] != experiment.name:
            return f"it is of {row['experiment']!r}, cell {row['cell']!r}"
        return record_fault(row, threads)

    def order(row: Row) -> tuple[int, int]:
        return cells.get(row["cell"], len(cells)), row["index"]

    hashes = {"spec": f"{experiment.name} {experiment.content_hash[:16]}"}
    return Owner(hashes, ("unit_id",), order, fault, _MEND)


def open_ledger(folder: Path, experiment: ExperimentSpec, read_only: bool = False) -> Ledger:
    """Open the ledger of an experiment; see :meth:`experiments.jobs.ledger.Ledger.open`."""
    return Ledger.open(folder, owner_of(experiment), read_only)


def read_experiment(folder: Path | str) -> "tuple[ExperimentSpec, pd.DataFrame]":
    """Read the spec of an experiment and the table of its units, also during a run.

    Args:
        folder: with a ledger, or with only the exported table.

    Returns:
        The spec, and one row per unit in the order of cells and index, with the columns of
        :func:`experiments.eq1.records.columns`: nullable boolean, Int64, Float64 and string.

    Raises:
        InputError: it is not an experiment's folder, or its rows are damaged.
    """
    spec, rows = read_rows(Path(folder))
    return spec, data_frame(rows, len(spec.threads))


def read_rows(folder: Path) -> tuple[ExperimentSpec, list[Row]]:
    """Read the same as :func:`read_experiment`, the records as plain rows."""
    spec = read_spec(folder)
    if _is_exported(folder):
        return spec, _exported_rows(folder, spec)
    with open_ledger(folder, spec, read_only=True) as ledger:
        return spec, ledger.rows()


def read_errors(folder: Path) -> list[Row]:
    """Read the infrastructure errors of an experiment; none if they were not exported with its table.

    Raises:
        InputError: it is not an experiment's folder, or its rows are damaged.
    """
    spec = read_spec(folder)
    if _is_exported(folder):
        most = _MOST_ERRORS * _units_of(spec)
        given = is_given(folder / ERRORS_FILE)
        return _read_table(folder / ERRORS_FILE, ERROR_COLUMNS, most) if given else []
    with open_ledger(folder, spec, read_only=True) as ledger:
        return ledger.errors()


def read_spec(folder: Path) -> ExperimentSpec:
    """Read the spec of an experiment's folder.

    No unit is drawn: a table's rows can be read where the code at hand refuses the conditions of its spec.

    Raises:
        InputError: the folder has no spec.
    """
    if not is_given(folder / SPEC_FILE):
        raise InputError(str(folder), f"has no {SPEC_FILE}", "give the folder of an experiment that was run")
    file = read_spec_file(folder / SPEC_FILE)
    return validated(file.data, file)


def release_of(folder: Path) -> str | None:
    """The release that replays an exported table; None for a ledger.

    Raises:
        InputError: it is no such table.
    """
    if not _is_exported(folder):
        return None
    with open_parquet(folder / TABLE_FILE) as file:
        return _about(file).get(b"release", b"unknown").decode()


def claim_folder(folder: Path) -> None:
    """Create the folder of an experiment, or check that it is one.

    Raises:
        InputError: it holds other files or cannot be created.
    """
    own = {SPEC_FILE, LOCK_FILE, *(LEDGER_FILE + end for end in ("", "-wal", "-shm", "-journal"))}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Of a run that was killed while it wrote its spec.
        sweep(folder, f".{SPEC_FILE}.partial-")
        found = {path.name for path in folder.iterdir()}
    except OSError as error:
        raise unwritable(folder, error) from error
    if found - own and LEDGER_FILE not in found:
        raise InputError(str(folder), "already holds files", "choose a new folder, or empty this one first")


def write_spec(folder: Path, experiment: ExperimentSpec) -> None:
    """Write the spec beside its ledger.

    Raises:
        InputError: it cannot be written.
    """
    write_file(folder / SPEC_FILE, partial(Path.write_text, data=experiment.as_yaml(), encoding="utf-8"))


def export(folder: Path, csv: bool = False) -> Path:
    """Write ``units.parquet``, one row per unit, and the infrastructure errors; returns its path.

    Columns, their types and the order of rows depend only on the spec.

    Args:
        folder: of an experiment that was run.
        csv: write ``units.csv`` too.

    Raises:
        InputError: it is not such a folder, or cannot be written.
    """
    import pyarrow as pa

    spec = read_spec(folder)
    threads = len(spec.threads)
    with open_ledger(folder, spec, read_only=True) as ledger:
        rows, errors = ledger.rows(), ledger.errors()
    about = {
        "experiment": spec.name,
        "spec_hash": spec.content_hash,
        "spec_digest": spec_digest(folder),
        "release": release(),
    }
    for name, types, found in (
        (TABLE_FILE, columns(threads), rows),
        (ERRORS_FILE, ERROR_COLUMNS, errors),
    ):
        told = about | {"digest": rows_digest(found)}
        schema = pa.schema([(column, getattr(pa, _ARROW[kind])()) for column, kind in types.items()], told)
        write_file(folder / name, partial(_write_parquet, rows=found, schema=schema))
    if csv:
        to_csv = data_frame(rows, threads).to_csv
        write_file(folder / "units.csv", partial(to_csv, index=False, lineterminator="\n"))
    return folder / TABLE_FILE


def _write_parquet(path: Path, rows: list[Row], schema: Any) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.Table.from_pylist(rows, schema=schema), path, write_page_checksum=True)


@contextmanager
def open_parquet(path: Path) -> "Iterator[pq.ParquetFile]":
    """A file, of which nothing but its description has been read."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    open_file(path).close()
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            yield file
    except (pa.ArrowException, OSError, ValueError) as error:
        raise InputError(str(path), f"is no Parquet file or damaged ({error})", _EXPORT) from error


def _about(file: "pq.ParquetFile") -> dict[bytes, bytes]:
    return dict(file.schema_arrow.metadata or {})


def _read_table(
    path: Path,
    types: Mapping[str, ColumnType],
    most_rows: int,
    fault: Callable[[Row], str | None] = lambda row: None,
) -> list[Row]:
    """The rows of an exported table, as they were written beside the spec that is still there.

    A small file may hold millions of rows: none is read of a table that its description shows to be another.

    Args:
        path: of the table.
        types: of its columns.
        most_rows: that it can have.
        fault: describes what in a row contradicts itself, before its digest does so in general.
    """
    import pyarrow as pa

    with open_parquet(path) as file:
        about, found = _about(file), {field.name: str(field.type) for field in file.schema_arrow}
        if differing := set(found) ^ set(types):
            problem = f"is damaged: missing or unknown columns: {', '.join(sorted(differing))}"
            raise InputError(str(path), problem, _EXPORT)
        for name, kind in types.items():
            if found[name] != str(getattr(pa, _ARROW[kind])()):
                raise InputError(f"{path}: {name}", f"is damaged: it is of type {found[name]}", _EXPORT)
        if file.metadata.num_rows > most_rows:
            problem = f"has {file.metadata.num_rows} rows, more than the {most_rows} that its spec allows"
            raise InputError(str(path), problem, _EXPORT)
        table = file.read()
        table.validate(full=True)
        rows = table.to_pylist()
    if about.get(b"spec_digest") != spec_digest(path.parent).encode():
        raise InputError(str(path), "was exported with another spec.yaml than stands beside it", _EXPORT)
    for row in rows:
        if found_fault := fault(row):
            raise InputError(f"{path}: row {row.get('unit_id')!r}", f"is damaged: {found_fault}", _EXPORT)
    if about.get(b"digest") != rows_digest(rows).encode():
        raise InputError(str(path), "is damaged: its rows are not those that were written", _EXPORT)
    return rows


def _exported_rows(folder: Path, spec: ExperimentSpec) -> list[Row]:
    """The rows of an exported table."""
    owner, seen = owner_of(spec), set()

    def fault(row: Row) -> str | None:
        own = {row.get("unit_id"), (row.get("cell"), row.get("index"))}
        twice = "it occurs twice" if own & seen else None
        seen.update(own)
        return owner.fault(row) or twice

    return _read_table(folder / TABLE_FILE, columns(len(spec.threads)), _units_of(spec), fault)


def _units_of(spec: ExperimentSpec) -> int:
    return sum(map(spec.units_of, spec.cell_names()))


def _is_exported(folder: Path) -> bool:
    """True if the folder holds the exported table alone, without the ledger."""
    return not is_given(folder / LEDGER_FILE) and is_given(folder / TABLE_FILE)


def spec_digest(folder: Path) -> str:
    return hashlib.sha256(read_bytes(folder / SPEC_FILE, SETTINGS_BYTES)).hexdigest()


def rows_digest(rows: list[Row]) -> str:
    """Digest of rows: of theirs, in order."""
    return _digest_of({str(number): _digest_of(row) for number, row in enumerate(rows)})


def _digest_of(values: Mapping[str, Any]) -> str:
    # Minus zero is stored as zero.
    items = [(name, value + 0.0 if isinstance(value, float) else value) for name, value in values.items()]
    return hashlib.sha256(json.dumps(items).encode()).hexdigest()[:16]
