"""Plain data for report.json from results of the statistics."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import pandas as pd

from dslab.experiments.runs.files import plain


def of_trials(column: pd.Series) -> dict[str, Any]:
    """Count the true of the known values of a nullable column: events, units and their share."""
    events, units = int(is_true(column).sum()), int(column.notna().sum())
    return {"events": events, "units": units, "estimate": events / units if units else None}


def as_data(value: Any) -> Any:
    """Convert nested dataclasses to plain data."""
    if is_dataclass(value):
        return {field.name: as_data(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): as_data(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [as_data(item) for item in value]
    return None if _is_missing(value) else plain(value)


def is_true(column: pd.Series) -> pd.Series:
    """True where a nullable column is true; null gives false."""
    return column.fillna(False).astype(bool)


def is_false(column: pd.Series) -> pd.Series:
    """True where a nullable column is false; null gives false."""
    return ~column.fillna(True).astype(bool)


def numbers(column: pd.Series) -> list[float]:
    """Values of a column without nulls."""
    return [float(value) for value in column.dropna()]


def spread(column: pd.Series) -> dict[str, Any]:
    """Count, median, quartiles and range of the values of a column, without nulls."""
    values = pd.Series(numbers(column), dtype=float)
    names = {"low": 0.0, "quartile_1": 0.25, "median": 0.5, "quartile_3": 0.75, "high": 1.0}
    return {"units": len(values)} | {
        name: float(values.quantile(at)) if len(values) else None for name, at in names.items()
    }


def counted(column: pd.Series) -> dict[str, int]:
    """Count each text of a column, most frequent first, then by name."""
    counts = column.dropna()[lambda texts: texts != ""].value_counts()
    return {
        str(text): int(n) for text, n in sorted(counts.items(), key=lambda item: (-item[1], str(item[0])))
    }


def _is_missing(value: Any) -> bool:
    return value is pd.NA or value is pd.NaT
