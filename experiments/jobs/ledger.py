"""The ledger of many jobs: one SQLite file with a row per job.

Each row is written in one transaction when its job ends, and outlives any end of the writing process, also
``kill -9``. A row is flat JSON under a key of its own. Every row has a digest, and every table the number of
its rows and their joint digest. Whoever reads rows gets them as they were written, or an InputError.
"""

import hashlib
import json
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self

from dslab.scenarios.errors import InputError
from dslab.sim.io.folders import unwritable
from dslab.sim.unfinished import take_lock

LEDGER_FILE, LOCK_FILE = "ledger.sqlite", "driver.lock"
FORM = "4"
"""Of the tables; ledgers of another form are refused."""
Row = dict[str, Any]
Table = Literal["rows", "errors"]
_COLUMNS = "number, key, row, digest"
_BUSY_S = 30.0
_BROKEN = "put a copy back, or choose a new folder"
_UNUSABLE = {sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM, sqlite3.SQLITE_IOERR}
_REMEDIES = {
    sqlite3.SQLITE_FULL: ("the disk is full", "free some space and run the same command again"),
    sqlite3.SQLITE_NOTADB: ("is not a ledger", "choose a new folder"),
    sqlite3.SQLITE_BUSY: ("is held by another program", "end that program and run the same command again"),
}


@dataclass(frozen=True)
class Owner:
    """What the rows of a ledger are of.

    Attributes:
        hashes: what is the same for all of them, by its name in messages, such as ``spec``.
        key: columns that tell a row from all others.
        order: place of a row, or of an error, among the others.
        fault: describes what in a row contradicts itself or its owner; None if nothing does.
        mend: what to do if the ledger is damaged.
    """

    hashes: Mapping[str, str]
    key: Sequence[str]
    order: Callable[[Row], Any] = field(default=lambda row: 0)
    fault: Callable[[Row], str | None] = field(default=lambda row: None)
    mend: str = "choose a new folder"


class Ledger:
    """The rows of one owner; a context manager, opened by :meth:`open`."""

    def __init__(self, connection: sqlite3.Connection, path: Path, owner: Owner) -> None:
        self._connection = connection
        self.path = path
        self._owner = owner

    @classmethod
    def open(cls, folder: Path, owner: Owner, read_only: bool = False) -> Self:
        """Open the ledger of a folder, or create it.

        Args:
            folder: must exist.
            owner: of the rows.
            read_only: change nothing; possible while another process writes.

        Raises:
            InputError: it holds rows of another owner, is of another form, is missing although only to be
                read, or is damaged, or the disk is full.
        """
        path = Path(folder) / LEDGER_FILE
        if read_only and not path.is_file():
            remedy = "give the folder of an experiment that was run"
            raise InputError(str(folder), f"has no {LEDGER_FILE}", remedy)
        # SQLite removes its log with the last connection, if that may write.
        connection = _connect(path, "rw" if read_only else "rwc")
        try:
            with _explained(path):
                if read_only:
                    connection.execute("PRAGMA query_only=ON")
                else:
                    connection.execute("PRAGMA journal_mode=WAL")
                    # A commit costs little beside its job, so it may as well outlive a power failure.
                    connection.execute("PRAGMA synchronous=FULL")
                    _create_tables(connection, owner)
                _check_owner(connection, path, owner)
                if not read_only:
                    (found,) = connection.execute("PRAGMA integrity_check(1)").fetchone()
                    if found != "ok":
                        raise InputError(str(path), f"is damaged ({found})", _BROKEN)
        except BaseException:
            connection.close()
            raise
        return cls(connection, path, owner)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def add(self, *rows: Row, table: Table = "rows") -> None:
        """Write rows, all in one transaction; of a key that there is already, none can be written."""
        stored = []
        for row in rows:
            key = json.dumps([row[name] for name in self._owner.key]) if table == "rows" else None
            # Minus zero is stored as zero.
            content = {name: v + 0.0 if isinstance(v, float) else v for name, v in row.items()}
            text = json.dumps(content, allow_nan=False)
            stored.append((key, text, _digest(key, text)))
        with _explained(self.path), _transaction(self._connection):
            self._connection.executemany(f"INSERT INTO {table} (key, row, digest) VALUES (?, ?, ?)", stored)
            self._sum_up(table, len(stored), [digest for *_, digest in stored])

    def drop(self, rows: Iterable[Row]) -> None:
        """Delete rows, all in one transaction."""
        keys = [(json.dumps([row[name] for name in self._owner.key]),) for row in rows]
        with _explained(self.path), _transaction(self._connection):
            digests = []
            for key in keys:
                (digest,) = self._connection.execute("SELECT digest FROM rows WHERE key = ?", key).fetchone()
                digests.append(digest)
            self._connection.executemany("DELETE FROM rows WHERE key = ?", keys)
            self._sum_up("rows", -len(keys), digests)

    def rows(self, table: Table = "rows") -> list[Row]:
        """Every row, in the owner's order.

        Raises:
            InputError: the ledger is damaged.
        """
        with _explained(self.path):
            # Both in one transaction, for a run may be writing.
            self._connection.execute("BEGIN")
            stored = self._connection.execute(f"SELECT {_COLUMNS} FROM {table} ORDER BY number").fetchall()
            sums = "SELECT number, digest FROM sums WHERE name = ?"
            written = self._connection.execute(sums, (table,)).fetchone()
            self._connection.execute("COMMIT")
        rows = []
        for of in stored:
            row, fault = self._read(table, of)
            if fault is not None:
                where = f"{self.path}: {table} row {of['number']}, {of['key'] or ''}"
                raise InputError(where, f"is damaged: {fault}", self._owner.mend)
            rows.append(row)
        found = len(rows), _joint(of["digest"] for of in stored)
        if written is None or found != tuple(written):
            problem = f"is damaged: {len(rows)} {table} are not those that were written"
            raise InputError(str(self.path), problem, self._owner.mend)
        return sorted(rows, key=self._owner.order)

    def errors(self) -> list[Row]:
        """Every infrastructure error, in the owner's order, then of attempts.

        Raises:
            InputError: the ledger is damaged.
        """
        return self.rows("errors")

    def drop_damaged(self) -> None:
        """Delete the rows that are not as they were written, so that their jobs are run again."""
        with _explained(self.path), _transaction(self._connection):
            for table in ("rows", "errors"):
                stored = self._connection.execute(f"SELECT {_COLUMNS} FROM {table}").fetchall()
                sound = {of["number"]: of["digest"] for of in stored if self._read(table, of)[1] is None}
                damaged = [(of["number"],) for of in stored if of["number"] not in sound]
                self._connection.executemany(f"DELETE FROM {table} WHERE number = ?", damaged)
                sums = (table, len(sound), _joint(sound.values()))
                self._connection.execute("INSERT OR REPLACE INTO sums VALUES (?, ?, ?)", sums)

    def _read(self, table: Table, stored: sqlite3.Row) -> tuple[Row, str | None]:
        if stored["digest"] != _digest(stored["key"], stored["row"]):
            return {}, "it does not agree with its digest"
        row = json.loads(stored["row"])
        return row, self._owner.fault(row) if table == "rows" else None

    def _sum_up(self, table: Table, number: int, digests: Sequence[str]) -> None:
        (before,) = self._connection.execute("SELECT digest FROM sums WHERE name = ?", (table,)).fetchone()
        self._connection.execute(
            "UPDATE sums SET number = number + ?, digest = ? WHERE name = ?",
            (number, _joint([before, *digests]), table),
        )


@contextmanager
def ledger_of(folder: Path, owner: Owner) -> Iterator[Ledger]:
    """Make a folder unless it exists, and open its ledger for this process alone.

    Raises:
        InputError: as of :meth:`Ledger.open` and :func:`sole_driver`, or the folder cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(folder, error) from error
    with sole_driver(folder), Ledger.open(folder, owner) as ledger:
        yield ledger


def renew_ledger(folder: Path, owner: Owner, is_begun: bool, drop_damaged: bool = False) -> None:
    """Drop the damaged rows of a ledger, if that is wanted.

    Args:
        folder: of the ledger.
        owner: of its rows.
        is_begun: it had tables at some time.
        drop_damaged: delete rows that are damaged.

    Raises:
        InputError: the ledger cannot be read, or has been emptied, or the disk is full.
    """
    path = folder / LEDGER_FILE
    if not path.is_file():
        return
    with _explained(path), closing(_connect(path, "rw")) as connection:
        has_tables = _has_tables(connection)
    if has_tables and drop_damaged:
        with Ledger.open(folder, owner) as ledger:
            ledger.drop_damaged()
    elif is_begun and not has_tables:
        remedy = "put a copy back, or remove it to run all units again"
        raise InputError(str(path), "is empty: its rows are lost", remedy)


@contextmanager
def sole_driver(folder: Path) -> Iterator[None]:
    """Lock the folder for this process; the lock is released when the process ends, even if killed.

    Raises:
        InputError: another process holds the lock, or the folder cannot be written.
    """
    try:
        lock = os.open(folder / LOCK_FILE, os.O_CREAT | os.O_RDWR)
    except OSError as error:
        problem = f"cannot be locked ({error})"
        raise InputError(str(folder), problem, "choose a folder you may write to") from None
    try:
        if take_lock(lock) is False:
            remedy = "wait for its end or choose another folder"
            raise InputError(str(folder), "another run is at work in this folder", remedy)
        yield
    finally:
        os.close(lock)


def _digest(*texts: str | None) -> str:
    return hashlib.sha256(json.dumps(texts, default=repr).encode()).hexdigest()[:16]


def _joint(digests: Iterable[str]) -> str:
    """Digest of a set of rows, independent of their order: the exclusive or of theirs."""
    joint = 0
    for digest in digests:
        joint ^= int(digest, 16)
    return f"{joint:016x}"


def _connect(path: Path, mode: str) -> sqlite3.Connection:
    """Open an SQLite file: ``rw``, or ``rwc`` to create it."""
    with _explained(path):
        uri = f"{path.absolute().as_uri()}?mode={mode}"
        connection = sqlite3.connect(uri, uri=True, timeout=_BUSY_S, isolation_level=None)
    connection.row_factory = sqlite3.Row
    # Damaged text is found by its digest.
    connection.text_factory = lambda text: text.decode(errors="backslashreplace")
    return connection


def _has_tables(connection: sqlite3.Connection) -> bool:
    return connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'meta'").fetchone() is not None


def _create_tables(connection: sqlite3.Connection, owner: Owner) -> None:
    """Create the tables, all or none, unless they exist."""
    if _has_tables(connection):
        return
    meta = {"form": FORM, "owner": json.dumps(dict(owner.hashes))}
    meta["digest"] = _digest(*meta.values())
    with _transaction(connection):
        connection.execute("CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL)")
        connection.execute("CREATE TABLE sums (name TEXT PRIMARY KEY, number INTEGER, digest TEXT)")
        connection.executemany("INSERT INTO meta VALUES (?, ?)", meta.items())
        for table in ("rows", "errors"):
            connection.execute(
                f"CREATE TABLE {table} (number INTEGER PRIMARY KEY, key TEXT UNIQUE, row TEXT, digest TEXT)"
            )
            connection.execute("INSERT INTO sums VALUES (?, 0, ?)", (table, _joint([])))


def _check_owner(connection: sqlite3.Connection, path: Path, owner: Owner) -> None:
    """Check that a ledger is that of an owner.

    Raises:
        InputError: it is not, is of another form, has no tables yet, or its description is damaged.
    """
    if not _has_tables(connection):
        # The run that creates it has not yet created its tables, or was ended before.
        raise InputError(str(path), "holds nothing yet", "try again when the run has started")
    meta = dict(connection.execute("SELECT key, value FROM meta").fetchall())
    if meta.get("form") != FORM:
        remedy = "choose a new folder; `dslab experiment merge` takes the table that its version exports"
        raise InputError(str(path), "is of another version of the lab", remedy)
    if meta.get("digest") != _digest(meta["form"], meta.get("owner")):
        raise InputError(str(path), "is damaged: its description has changed", "choose a new folder")
    held = json.loads(meta["owner"])
    for name, given in owner.hashes.items():
        if held.get(name) != given:
            raise InputError(
                str(path.parent),
                f"holds rows of another {name} ({held.get(name)}, given is {given})",
                f"choose a new folder, or give the {name} of this one",
            )


@contextmanager
def _transaction(connection: sqlite3.Connection) -> Iterator[None]:
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
def _explained(path: Path) -> Iterator[None]:
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
        is_damage = code == sqlite3.SQLITE_CORRUPT or isinstance(error, sqlite3.OperationalError)
        if known is None and not is_damage:
            raise
        problem, remedy = known or (f"is damaged ({error})", _BROKEN)
        raise InputError(str(path), problem, remedy) from error
    except UnicodeDecodeError as error:  # the name of a table or column
        raise InputError(str(path), "is damaged (a name in it is no text)", "choose a new folder") from error
