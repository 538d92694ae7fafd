"""The SQLite file of a ledger: its tables, whose it is, and its errors as one clear line."""

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from dslab.experiments.eq1.record_checks import digest_of, joint_digest
from dslab.experiments.eq1.record_table import SQL_TYPES
from dslab.experiments.eq1.records import ColumnType
from dslab.scenarios.errors import InputError

if TYPE_CHECKING:
    from dslab.experiments.campaign.schedule import Experiment

SCHEMA_VERSION = 3
"""Since 3 units are replicates of sequences in worlds. Earlier ledgers are refused."""
ERROR_COLUMNS = ("unit_id", "cell", "index", "attempt", "at", "worker", "message", "report")
RERUN = (
    "add --rerun-damaged to `dslab experiment run`, which runs damaged units again, or choose a new folder"
)
_BUSY_S = 30.0
_UNUSABLE = {sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM, sqlite3.SQLITE_IOERR}
_REMEDIES = {
    sqlite3.SQLITE_FULL: ("the disk is full", "free some space and run the same command again"),
    sqlite3.SQLITE_CORRUPT: ("is damaged", RERUN),
    sqlite3.SQLITE_NOTADB: ("is not a ledger", "choose a new folder"),
    sqlite3.SQLITE_BUSY: ("is held by another program", "end that program and run the same command again"),
}


def connect(path: Path, mode: str) -> sqlite3.Connection:
    """Open an SQLite file.

    Args:
        path: of the file.
        mode: ``ro``, ``rw``, or ``rwc`` to create it.

    Raises:
        InputError: it cannot be opened.
    """
    with explained(path):
        uri = f"{path.absolute().as_uri()}?mode={mode}"
        connection = sqlite3.connect(uri, uri=True, timeout=_BUSY_S, isolation_level=None)
    connection.row_factory = sqlite3.Row
    # Damaged text is shown, and found by its digest.
    connection.text_factory = lambda text: text.decode(errors="backslashreplace")
    return connection


def has_tables(connection: sqlite3.Connection) -> bool:
    """True if the tables have been created."""
    return connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'meta'").fetchone() is not None


def create_tables(
    connection: sqlite3.Connection, experiment: "Experiment", types: Mapping[str, ColumnType]
) -> None:
    """Create the tables, all or none, unless they exist."""
    if has_tables(connection):
        return
    typed = ", ".join(f'"{name}" {SQL_TYPES[kind]}' for name, kind in types.items())
    meta = {
        "schema_version": str(SCHEMA_VERSION),
        "experiment": experiment.name,
        "spec_hash": experiment.content_hash,
        "threads": str(len(experiment.threads)),
    }
    meta["digest"] = digest_of(dict(sorted(meta.items())))
    nothing = joint_digest([])
    with transaction(connection):
        connection.execute("CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL)")
        connection.execute("CREATE TABLE sums (name TEXT PRIMARY KEY, number INTEGER, digest TEXT)")
        connection.execute(
            f'CREATE TABLE units ({typed}, digest TEXT, PRIMARY KEY (unit_id), UNIQUE (cell, "index"))'
        )
        connection.execute(
            "CREATE TABLE infrastructure_errors (number INTEGER PRIMARY KEY, unit_id TEXT, cell TEXT, "
            '"index" INTEGER, attempt INTEGER, at TEXT, worker TEXT, message TEXT, report TEXT, digest TEXT)'
        )
        connection.executemany("INSERT INTO meta VALUES (?, ?)", meta.items())
        tables = ("units", "infrastructure_errors")
        connection.executemany("INSERT INTO sums VALUES (?, 0, ?)", [(name, nothing) for name in tables])


def check_owner(
    connection: sqlite3.Connection, path: Path, experiment: "Experiment", types: Mapping[str, ColumnType]
) -> None:
    """Check that a ledger is that of an experiment.

    Raises:
        InputError: it is not, is of an earlier version, has no tables yet, or its description is damaged.
    """
    if not has_tables(connection):
        # The run that creates it has not yet created its tables, or was ended before.
        raise InputError(str(path), "holds nothing yet", "try again when the run has started")
    meta = dict(connection.execute("SELECT key, value FROM meta ORDER BY key").fetchall())
    known, of_errors = (
        {row["name"] for row in connection.execute(f"PRAGMA table_info({table})")}
        for table in ("units", "infrastructure_errors")
    )
    if meta.get("schema_version") in ("1", "2"):
        problem = "is of an earlier version: its units were drawn and judged otherwise"
        remedy = (
            "choose a new folder; `dslab experiment report` still reads tables that were exported from it"
        )
        raise InputError(str(path), problem, remedy)
    if meta.get("schema_version") != str(SCHEMA_VERSION):
        problem = f"has the form {meta.get('schema_version')!r}, this is {SCHEMA_VERSION}"
        raise InputError(str(path), problem, "choose a new folder")
    digest = meta.pop("digest", None)
    if digest != digest_of(meta):
        raise InputError(str(path), "is damaged: its description has changed", "choose a new folder")
    held, given = meta.get("spec_hash", ""), experiment.content_hash
    if held != given:
        raise InputError(
            str(path.parent),
            f"holds units of another spec ({meta.get('experiment')} {held[:12]}, given is {given[:12]})",
            "choose a new folder, or give the spec.yaml of this one",
        )
    if known != {*types, "digest"} or of_errors != {"number", *ERROR_COLUMNS, "digest"}:
        problem = "has other columns than this version of the programs writes"
        raise InputError(str(path), problem, "choose a new folder")


@contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """Change all that the block changes, or nothing."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
        raise


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Convert database errors to one clear line."""
    try:
        yield
    except sqlite3.DatabaseError as error:
        # The lowest byte of an extended code is the plain code.
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        if code in _UNUSABLE:
            known = f"cannot be used ({error})", "choose a folder you may write to, on a local disk"
        else:
            known = _REMEDIES.get(code)
        if known is None and not isinstance(error, sqlite3.OperationalError):
            raise
        problem, remedy = known or (f"is damaged ({error})", RERUN)
        raise InputError(str(path), problem, remedy) from error
    except UnicodeDecodeError as error:  # the name of a table or column
        raise InputError(str(path), "is damaged (a name in it is no text)", "choose a new folder") from error
