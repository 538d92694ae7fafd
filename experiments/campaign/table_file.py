"""The exported table of units, a Parquet file with a digest over its rows."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from dslab.experiments.campaign.schedule import Experiment
from dslab.experiments.eq1.record_table import arrow_table, digest_of, record_fault
from dslab.experiments.eq1.records import columns
from dslab.experiments.runs.provenance import release
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import open_file

ERROR_COLUMNS = ("unit_id", "cell", "index", "attempt", "at", "worker", "message", "report")
_DIGEST, _SPEC_DIGEST, _RELEASE = b"digest", b"spec_digest", b"release"
_REMEDY = "export it anew from its ledger, by the version that wrote it"


def write_table(path: Path, rows: list[dict[str, Any]], spec: Experiment, spec_digest: str) -> None:
    """Write the records of an experiment.

    Args:
        path: of the file.
        rows: normalised records, in order.
        spec: of the experiment.
        spec_digest: of the file of the spec.

    Raises:
        OSError: it cannot be written.
    """
    import pyarrow.parquet as pq

    about = {"experiment": spec.name, "spec_hash": spec.content_hash, "spec_digest": spec_digest}
    about |= {"digest": _digest(rows), "release": release()}
    table = arrow_table(rows, len(spec.threads)).replace_schema_metadata(about)
    pq.write_table(table, path, write_page_checksum=True)


def write_errors(path: Path, errors: list[dict[str, Any]]) -> None:
    """Write the infrastructure errors of an experiment.

    Raises:
        OSError: it cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    whole = {"index", "attempt"}
    schema = pa.schema([(name, pa.int64() if name in whole else pa.string()) for name in ERROR_COLUMNS])
    pq.write_table(pa.Table.from_pylist(errors, schema=schema), path)


def read_error_table(path: Path) -> list[dict[str, Any]]:
    """Read the infrastructure errors of an experiment.

    Raises:
        InputError: it is no such table.
    """
    _, rows, _ = _parquet(path)
    return rows


def read_table(path: Path, spec: Experiment, spec_digest: str) -> list[dict[str, Any]]:
    """Read the records of an experiment, whose spec is still the one of their export.

    Raises:
        InputError: it is no such table, or not as it was written.
    """
    names, found, about = _parquet(path)
    if about.get(_SPEC_DIGEST) != spec_digest.encode():
        raise InputError(str(path), "was exported with another spec.yaml than stands beside it", _REMEDY)
    types = columns(len(spec.threads))
    if differing := set(types) ^ set(names):
        problem = f"missing or unknown columns: {', '.join(sorted(differing))}"
        raise InputError(str(path), problem, _REMEDY)
    _check(path, found, spec)
    if about.get(_DIGEST) != _digest(found).encode():
        raise InputError(str(path), "is damaged: its rows are not those that were written", _REMEDY)
    return found


def table_release(path: Path) -> str:
    """The release that replays the rows of an exported table.

    Raises:
        InputError: it is no such table.
    """
    return _parquet(path)[2].get(_RELEASE, b"unknown").decode()


def _parquet(path: Path) -> tuple[list[str], list[dict[str, Any]], dict[bytes, bytes]]:
    """Names of columns, rows and metadata of a file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    open_file(path).close()
    try:
        table = pq.read_table(path, page_checksum_verification=True)
        table.validate(full=True)
        return table.column_names, table.to_pylist(), dict(table.schema.metadata or {})
    except (pa.ArrowException, OSError, ValueError) as error:
        raise InputError(str(path), f"is no Parquet file or damaged ({error})", _REMEDY) from error


def _check(path: Path, rows: Iterable[Mapping[str, Any]], spec: Experiment) -> None:
    cells, seen = set(spec.cell_names()), set()
    for row in rows:
        fault = record_fault(row, len(spec.threads))
        if fault is None and (row["cell"] not in cells or row["experiment"] != spec.name):
            fault = f"it is of {row['experiment']!r}, cell {row['cell']!r}"
        if fault is None and (row["unit_id"] in seen or (row["cell"], row["index"]) in seen):
            fault = "it occurs twice"
        if fault is not None:
            raise InputError(f"{path}: row {row['unit_id']!r}", f"is damaged: {fault}", _REMEDY)
        seen |= {row["unit_id"], (row["cell"], row["index"])}


def _digest(rows: Iterable[Mapping[str, Any]]) -> str:
    return digest_of({str(number): digest_of(row) for number, row in enumerate(rows)})
