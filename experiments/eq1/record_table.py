"""Records as typed tables: the types of columns in Python, SQLite, pandas and Parquet."""

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from dslab.experiments.eq1.records import DOMAINS, ROUNDING, ColumnType, Domain, columns, domains

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

SQL_TYPES: dict[ColumnType, str] = {"bool": "INTEGER", "int": "INTEGER", "float": "REAL", "text": "TEXT"}
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
