"""Checks of records that were stored: types, domains, and the digest over all columns."""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

from dslab.experiments.eq1.records import (
    DOMAINS,
    GIVEN_BREAKAGE,
    NEVER_NULL,
    Domain,
    Outcome,
    domains,
)

_PYTHON_TYPES = {"bool": bool, "int": int, "float": float, "text": str}


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


def _fits(value: Any, domain: Domain, nullable: bool) -> bool:
    if value is None:
        return nullable
    kind, low, high = DOMAINS[domain]
    if type(value) is not _PYTHON_TYPES[kind]:
        return False
    if kind == "text":
        return bool(value) or domain != "name"
    return math.isfinite(value) and low <= value <= high
