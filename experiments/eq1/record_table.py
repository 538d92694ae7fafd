"""Records as typed rows, in Python, SQLite, pandas and Parquet; their digests and what contradicts them."""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from dslab.experiments.eq1.records import (
    DOMAINS,
    GIVEN_BREAKAGE,
    NEVER_NULL,
    ROUNDING,
    ColumnType,
    Domain,
    Outcome,
    columns,
    domains,
)

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

SQL_TYPES: dict[ColumnType, str] = {"bool": "INTEGER", "int": "INTEGER", "float": "REAL", "text": "TEXT"}
_PYTHON_TYPES = {"bool": bool, "int": int, "float": float, "text": str}
PANDAS_TYPES: dict[ColumnType, str] = {
    "bool": "boolean",
    "int": "Int64",
    "float": "Float64",
    "text": "string",
}


def normalise(record: Mapping[str, Any], threads: int) -> dict[str, Any]:
    """Convert a record to plain Python values of its columns' types, in their order.

    NaN and infinities become null; a share that is beyond its ends by rounding becomes that end.

    Args:
        record: from a unit.
        threads: number of recovery threads.

    Raises:
        ValueError: a column is missing or unknown, or a value is not of its type or out of its domain.
    """
    known = domains(threads)
    if differing := set(record) ^ set(known):
        raise ValueError(f"missing or unknown columns: {', '.join(sorted(differing))}")
    return {name: _within(name, record[name], domain) for name, domain in known.items()}


def storable(text: str) -> str:
    """A text with escapes for what UTF-8 cannot hold, as names of files may."""
    return text.encode(errors="backslashreplace").decode()


def data_frame(records: Iterable[Mapping[str, Any]], threads: int) -> "pd.DataFrame":
    """Records as a table with nullable columns: boolean, Int64, Float64 and string.

    Args:
        records: normalised; may be empty.
        threads: number of recovery threads.
    """
    import pandas as pd

    rows = list(records)
    return pd.DataFrame(
        {
            name: pd.array([row[name] for row in rows], dtype=PANDAS_TYPES[kind])
            for name, kind in columns(threads).items()
        }
    )


def arrow_table(records: Iterable[Mapping[str, Any]], threads: int) -> "pa.Table":
    """Records as an Arrow table, whose column types do not depend on the rows."""
    import pyarrow as pa

    kinds = {"bool": pa.bool_(), "int": pa.int64(), "float": pa.float64(), "text": pa.string()}
    schema = pa.schema([(name, kinds[kind]) for name, kind in columns(threads).items()])
    return pa.Table.from_pylist(list(records), schema=schema)


def digest_of(values: Mapping[str, Any]) -> str:
    """Sixteen hexadecimal digits of the SHA-256 of a row: its names and values, in order."""
    # SQLite stores -0.0 as 0.0.
    items = [(name, value + 0.0 if isinstance(value, float) else value) for name, value in values.items()]
    return hashlib.sha256(json.dumps(items).encode()).hexdigest()[:16]


def joint_digest(digests: Iterable[str]) -> str:
    """Digest of a set of rows, independent of their order: the exclusive or of theirs."""
    joint = 0
    for digest in digests:
        joint ^= int(digest, 16)
    return f"{joint:016x}"


def record_fault(record: Mapping[str, Any], threads: int) -> str | None:
    """Describe what in a record contradicts its columns; None if nothing does.

    Args:
        record: with the columns of `records.columns`.
        threads: number of recovery threads.
    """
    for name, domain in domains(threads).items():
        if not _fits(record[name], domain, name not in NEVER_NULL):
            return f"{name} is {record[name]!r}"
    if record["outcome"] not in set(Outcome):
        return f"outcome is {record['outcome']!r}"
    if not record["breakage"]:
        given = (n for n in record if n in GIVEN_BREAKAGE or n.startswith("free_r"))
        if name := next((n for n in given if record[n] is not None), None):
            return f"{name} is {record[name]!r} although breakage is {record['breakage']!r}"
    return None


def _within(name: str, value: Any, domain: Domain) -> Any:
    kind, low, high = DOMAINS[domain]
    plain = _plain(name, value, kind)
    if plain is None or kind == "text":
        return plain
    slack = ROUNDING if domain == "share" else 0
    if not low - slack <= plain <= high + slack:
        raise ValueError(f"{name}: {value!r} is not from {low:g} to {high:g}")
    return min(max(plain, float(low)), float(high)) if slack else plain


def _plain(name: str, value: Any, kind: ColumnType) -> Any:
    if value is None:
        return None
    fitting = (
        isinstance(value, str) if kind == "text" else isinstance(value, int | float | np.number | np.bool_)
    )
    if fitting and kind == "text":
        return storable(str(value))
    if fitting and kind == "float":
        return float(value) if math.isfinite(value) else None
    if fitting and math.isfinite(value) and value == int(value) and (kind == "int" or value in (0, 1)):
        return bool(value) if kind == "bool" else int(value)
    raise ValueError(f"{name}: {value!r} is not of type {kind}")


def _fits(value: Any, domain: Domain, nullable: bool) -> bool:
    if value is None:
        return nullable
    kind, low, high = DOMAINS[domain]
    if type(value) is not _PYTHON_TYPES[kind]:
        return False
    if kind == "text":
        return bool(value) or domain != "name"
    return math.isfinite(value) and low <= value <= high
