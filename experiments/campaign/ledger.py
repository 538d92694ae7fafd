"""The ledger of an experiment: one SQLite file with a row per unit.

Each row is written in one transaction when its unit ends, and outlives any end of the writing process, also
``kill -9``. Units are keyed by the content hash of their spec, and the ledger by that of the experiment: rows
of different specs never mix. Infrastructure errors, one row per attempt, have their own table.
"""

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from experiments.eq1.record_table import SQL_TYPES, data_frame
from experiments.eq1.records import Outcome, columns
from experiments.eq1.units import UnitSpec
from scenarios.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from experiments.campaign.schedule import Experiment

LEDGER_FILE = "ledger.sqlite"
SCHEMA_VERSION = 1
ERROR_COLUMNS = ("unit_id", "cell", "index", "attempt", "at", "worker", "message", "report")
_BUSY_S = 30.0
_REMEDIES = {
    sqlite3.SQLITE_FULL: ("the disk is full", "free some space and run the same command again"),
    sqlite3.SQLITE_CORRUPT: ("is damaged", "choose a new folder"),
    sqlite3.SQLITE_NOTADB: ("is not a ledger", "choose a new folder"),
    sqlite3.SQLITE_BUSY: ("is held by another program", "end that program and run the same command again"),
}


class Ledger:
    """The rows of an experiment; a context manager, opened by :meth:`open`."""

    def __init__(self, connection: sqlite3.Connection, path: Path, experiment: "Experiment") -> None:
        self._connection = connection
        self._connection.row_factory = sqlite3.Row
        self.path = path
        self._threads = len(experiment.threads)
        self._types = columns(self._threads)
        self._cells = {cell: place for place, cell in enumerate(experiment.cell_names())}

    @classmethod
    def open(cls, folder: Path, experiment: "Experiment", read_only: bool = False) -> Self:
        """Open the ledger of a folder, or create it.

        Args:
            folder: of the experiment; must exist.
            experiment: owner of the units.
            read_only: change nothing; possible during a run.

        Raises:
            InputError: it holds units of another spec, is missing although only to be read, or is damaged, or
                the disk is full.
        """
        path = Path(folder) / LEDGER_FILE
        if read_only and not path.is_file():
            raise InputError(
                str(folder), f"has no {LEDGER_FILE}", "give the folder of an experiment that was run"
            )
        with _explained(path):
            mode = "ro" if read_only else "rwc"
            connection = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode={mode}", uri=True, timeout=_BUSY_S, isolation_level=None
            )
        ledger = cls(connection, path, experiment)
        try:
            with _explained(path):
                if not read_only:
                    connection.execute("PRAGMA journal_mode=WAL")
                    # A commit costs little beside its unit, so it may as well outlive a power failure.
                    connection.execute("PRAGMA synchronous=FULL")
                    ledger._create(experiment)
                ledger._check(experiment)
        except BaseException:
            connection.close()
            raise
        return ledger

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def add(self, record: Mapping[str, Any]) -> None:
        """Write the row of a unit that has ended, in one transaction.

        Args:
            record: normalised, with ``attempts`` filled in.
        """
        names = ", ".join(f'"{name}"' for name in self._types)
        marks = ", ".join("?" * len(self._types))
        with _explained(self.path):
            self._connection.execute(
                f"INSERT INTO units ({names}) VALUES ({marks})", [record[name] for name in self._types]
            )

    def add_error(self, unit: UnitSpec, attempt: int, worker: str, message: str, report: str = "") -> None:
        """Write the row of an infrastructure error.

        Args:
            unit: the failed unit.
            attempt: number of the try, from 1.
            worker: address of the worker.
            message: one line.
            report: stacks of the threads if known.
        """
        at = datetime.now(UTC).isoformat(timespec="seconds")
        names = ", ".join(f'"{name}"' for name in ERROR_COLUMNS)
        values = (unit.unit_id, unit.cell, unit.index, attempt, at, worker, message, report)
        with _explained(self.path):
            self._connection.execute(
                f"INSERT INTO infrastructure_errors ({names}) VALUES ({', '.join('?' * len(values))})", values
            )

    def forget_errors(self) -> int:
        """Delete the rows of units given up after infrastructure errors; returns their number."""
        ended_so = (Outcome.INFRASTRUCTURE_ERROR.value,)
        with _explained(self.path):
            return self._connection.execute("DELETE FROM units WHERE outcome = ?", ended_so).rowcount

    def rows(self) -> list[dict[str, Any]]:
        """Every record, in the order of the spec: by cell, then by index."""
        with _explained(self.path):
            found = [self._record(row) for row in self._connection.execute("SELECT * FROM units")]
        return sorted(found, key=lambda record: (self._cells[record["cell"]], record["index"]))

    def records(self) -> "pd.DataFrame":
        """Every record as a typed table, in the order of the spec."""
        return data_frame(self.rows(), self._threads)

    def record(self, unit_id: str) -> dict[str, Any] | None:
        """The record of a unit; None if there is none."""
        with _explained(self.path):
            row = self._connection.execute("SELECT * FROM units WHERE unit_id = ?", (unit_id,)).fetchone()
        return None if row is None else self._record(row)

    def errors(self) -> list[dict[str, Any]]:
        """Every infrastructure error, in the order of the spec, then of attempts."""
        with _explained(self.path):
            rows = self._connection.execute("SELECT * FROM infrastructure_errors ORDER BY number").fetchall()
        found = [{name: row[name] for name in ERROR_COLUMNS} for row in rows]
        return sorted(found, key=lambda error: (self._cells[error["cell"]], error["index"]))

    def _record(self, row: sqlite3.Row) -> dict[str, Any]:
        return {
            name: bool(row[name]) if kind == "bool" and row[name] is not None else row[name]
            for name, kind in self._types.items()
        }

    def _create(self, experiment: "Experiment") -> None:
        """Create the tables, all or none, unless they exist."""
        if self._connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'meta'").fetchone():
            return
        typed = ", ".join(f'"{name}" {SQL_TYPES[kind]}' for name, kind in self._types.items())
        meta = {
            "schema_version": str(SCHEMA_VERSION),
            "experiment": experiment.name,
            "spec_hash": experiment.content_hash,
            "threads": str(len(experiment.threads)),
        }
        self._connection.execute("BEGIN IMMEDIATE")
        try:
            self._connection.execute("CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL)")
            self._connection.execute(
                f'CREATE TABLE units ({typed}, PRIMARY KEY (unit_id), UNIQUE (cell, "index"))'
            )
            self._connection.execute(
                "CREATE TABLE infrastructure_errors (number INTEGER PRIMARY KEY, unit_id TEXT, cell TEXT, "
                '"index" INTEGER, attempt INTEGER, at TEXT, worker TEXT, message TEXT, report TEXT)'
            )
            self._connection.executemany("INSERT INTO meta VALUES (?, ?)", meta.items())
            self._connection.execute("COMMIT")
        except BaseException:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")
            raise

    def _check(self, experiment: "Experiment") -> None:
        if not self._connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'meta'").fetchone():
            # The run that creates it has not yet created its tables, or was ended before.
            raise InputError(str(self.path), "holds nothing yet", "try again when the run has started")
        meta = dict(self._connection.execute("SELECT key, value FROM meta").fetchall())
        if meta.get("schema_version") != str(SCHEMA_VERSION):
            raise InputError(
                str(self.path), f"has the form {meta.get('schema_version')}, this is {SCHEMA_VERSION}",
                "choose a new folder",
            )  # fmt: skip
        held, given = meta["spec_hash"], experiment.content_hash
        if held != given:
            raise InputError(
                str(self.path.parent),
                f"holds units of another spec ({meta['experiment']} {held[:12]}, given is {given[:12]})",
                "choose a new folder, or give the spec.yaml of this one",
            )
        known = {row["name"] for row in self._connection.execute("PRAGMA table_info(units)")}
        if known != set(self._types):
            raise InputError(
                str(self.path),
                "has other columns than this version of the programs writes",
                "choose a new folder",
            )


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Convert database errors to one clear line."""
    try:
        yield
    except sqlite3.DatabaseError as error:
        code = getattr(error, "sqlite_errorcode", None)
        # The lowest byte of an extended code is the plain code.
        known = _REMEDIES.get(code & 0xFF) if code is not None else None
        if known is None and not isinstance(error, sqlite3.OperationalError):
            raise
        problem, remedy = known or (
            f"cannot be used ({error})",
            "choose a folder you may write to, on a local disk",
        )
        raise InputError(str(path), problem, remedy) from error
