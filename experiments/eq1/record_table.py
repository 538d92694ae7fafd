"""Records as typed rows of plain values, in Python and pandas, and what contradicts them."""

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

_PYTHON_TYPES = {"bool": bool, "int": int, "float": float, "text": str}
_PANDAS_TYPES: dict[ColumnType, str] = {
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
    return {name: _plain(name, record[name], domain) for name, domain in known.items()}


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
    types = {name: _PANDAS_TYPES[kind] for name, kind in columns(threads).items()}
    return pd.DataFrame({name: pd.array([row[name] for row in rows], dtype=t) for name, t in types.items()})


def record_fault(record: Mapping[str, Any], threads: int) -> str | None:
    """Describe what in a record contradicts its columns; None if nothing does.

    Args:
        record: with the columns of `records.columns`.
        threads: number of recovery threads.
    """
    try:
        plain = normalise(record, threads)
    except ValueError as error:
        return str(error)
    for name, domain in domains(threads).items():
        value = record[name]
        lacks = name in NEVER_NULL if value is None else domain == "name" and not value
        if lacks or (type(value), value) != (type(plain[name]), plain[name]):
            return f"{name} is {value!r}"
    if record["outcome"] not in set(Outcome):
        return f"outcome is {record['outcome']!r}"
    if not record["breakage"]:
        given = (n for n in record if n in GIVEN_BREAKAGE or n.startswith("free_r"))
        if name := next((n for n in given if record[n] is not None), None):
            return f"{name} is {record[name]!r} although breakage is {record['breakage']!r}"
    return None


def _plain(name: str, value: Any, domain: Domain) -> Any:
    kind, low, high = DOMAINS[domain]
    if value is None:
        return None
    if kind == "text" and isinstance(value, str):
        return storable(str(value))
    if kind == "text" or not isinstance(value, int | float | np.number | np.bool_):
        raise ValueError(f"{name}: {value!r} is not of type {kind}")
    if kind == "float" and not math.isfinite(value):
        return None
    if kind != "float" and not (math.isfinite(value) and value == int(value)):
        raise ValueError(f"{name}: {value!r} is not of type {kind}")
    slack = ROUNDING if domain == "share" else 0
    if not low - slack <= value <= high + slack:
        raise ValueError(f"{name}: {value!r} is not from {low:g} to {high:g}")
    return _PYTHON_TYPES[kind](min(max(value, low), high) if slack else value)
