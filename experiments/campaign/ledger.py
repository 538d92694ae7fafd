"""The ledger of an experiment: one SQLite file with a row per unit.

Each row is written in one transaction when its unit ends, and outlives any end of the writing process, also
``kill -9``. Units are keyed by the content hash of their spec, and the ledger by that of the experiment: rows
of different specs never mix. Infrastructure errors, one row per attempt, have their own table.

Every row has a digest, and every table the number of its rows and their joint digest. Whoever reads rows gets
them as they were written, or an InputError.
"""

import sqlite3
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from dslab.experiments.campaign.ledger_file import (
    ERROR_COLUMNS,
    RERUN,
    check_owner,
    connect,
    create_tables,
    explained,
    transaction,
)
from dslab.experiments.eq1.record_checks import digest_of, joint_digest, record_fault
from dslab.experiments.eq1.record_table import data_frame, storable
from dslab.experiments.eq1.records import Outcome, columns
from dslab.experiments.eq1.units import UnitSpec
from dslab.scenarios.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from dslab.experiments.campaign.schedule import Experiment

LEDGER_FILE = "ledger.sqlite"
Table = Literal["units", "infrastructure_errors"]
Row = dict[str, Any]


class Ledger:
    """The rows of an experiment; a context manager, opened by :meth:`open`."""

    def __init__(self, connection: sqlite3.Connection, path: Path, experiment: "Experiment") -> None:
        self._connection = connection
        self.path = path
        self._experiment = experiment.name
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
            InputError: it holds units of another spec, is of an earlier version, is missing although only to
                be read, or is damaged, or the disk is full.
        """
        path = Path(folder) / LEDGER_FILE
        if read_only and not path.is_file():
            remedy = "give the folder of an experiment that was run"
            raise InputError(str(folder), f"has no {LEDGER_FILE}", remedy)
        connection = connect(path, "ro" if read_only else "rwc")
        ledger = cls(connection, path, experiment)
        try:
            with explained(path):
                if not read_only:
                    connection.execute("PRAGMA journal_mode=WAL")
                    # A commit costs little beside its unit, so it may as well outlive a power failure.
                    connection.execute("PRAGMA synchronous=FULL")
                    create_tables(connection, experiment, ledger._types)
                check_owner(connection, path, experiment, ledger._types)
                if not read_only:
                    ledger._check_writable()
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
        self.add_rows("units", [record])

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
        said = storable(message), storable(report)
        values = (unit.unit_id, unit.cell, unit.index, attempt, at, worker, *said)
        self.add_rows("infrastructure_errors", [dict(zip(ERROR_COLUMNS, values, strict=True))])

    def add_rows(self, table: Table, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write rows of a table, all in one transaction."""
        names = self._names(table)
        digests = [digest_of({name: row[name] for name in names}) for row in rows]
        values = [[*(row[name] for name in names), d] for row, d in zip(rows, digests, strict=True)]
        named = ", ".join(f'"{name}"' for name in (*names, "digest"))
        marks = ", ".join("?" * (len(names) + 1))
        with explained(self.path), transaction(self._connection):
            self._connection.executemany(f"INSERT INTO {table} ({named}) VALUES ({marks})", values)
            self._sum_up(table, len(rows), digests)

    def forget_errors(self) -> int:
        """Delete the rows of units given up after infrastructure errors; returns their number."""
        given_up = (Outcome.INFRASTRUCTURE_ERROR.value,)
        with explained(self.path), transaction(self._connection):
            found = self._connection.execute(
                "SELECT digest FROM units WHERE outcome = ?", given_up
            ).fetchall()
            self._connection.execute("DELETE FROM units WHERE outcome = ?", given_up)
            self._sum_up("units", -len(found), [row["digest"] for row in found])
        return len(found)

    def rows(self) -> list[Row]:
        """Every record, in the order of the spec: by cell, then by index.

        Raises:
            InputError: the ledger is damaged.
        """
        return self._in_order(self._verified("units"))

    def records(self) -> "pd.DataFrame":
        """Every record as a typed table, in the order of the spec."""
        return data_frame(self.rows(), self._threads)

    def errors(self) -> list[Row]:
        """Every infrastructure error, in the order of the spec, then of attempts.

        Raises:
            InputError: the ledger is damaged.
        """
        return self._in_order(self._verified("infrastructure_errors"))

    def sound_rows(self, table: Table) -> list[Row]:
        """The rows of a table that can be read and are as they were written."""
        found, cursor = [], self._connection.execute(f"SELECT * FROM {table}")
        try:
            for stored in cursor:
                row = self._plain(table, stored)
                if self._fault(table, row, stored) is None:
                    found.append(row)
        except sqlite3.DatabaseError:  # what comes after cannot be reached
            pass
        return found

    def _verified(self, table: Table) -> list[Row]:
        with explained(self.path):
            # Both in one transaction, for a run may be writing.
            self._connection.execute("BEGIN")
            stored = self._connection.execute(f"SELECT * FROM {table} ORDER BY rowid").fetchall()
            sums = "SELECT number, digest FROM sums WHERE name = ?"
            written = self._connection.execute(sums, (table,)).fetchone()
            self._connection.execute("COMMIT")
        rows = [self._plain(table, row) for row in stored]
        for row, of in zip(rows, stored, strict=True):
            if fault := self._fault(table, row, of):
                raise InputError(
                    f"{self.path}: {table} row {row['unit_id']!r}", f"is damaged: {fault}", RERUN
                )
        found = len(rows), joint_digest(row["digest"] for row in stored)
        if written is None or found != tuple(written):
            problem = f"is damaged: {len(rows)} rows of {table} are not those that were written"
            raise InputError(str(self.path), problem, RERUN)
        return rows

    def _fault(self, table: Table, row: Row, stored: sqlite3.Row) -> str | None:
        fault = record_fault(row, self._threads) if table == "units" else None
        if fault is None and row["cell"] not in self._cells:
            fault = f"cell is {row['cell']!r}"
        if fault is None and row.get("experiment", self._experiment) != self._experiment:
            fault = f"experiment is {row['experiment']!r}"
        if fault is None and stored["digest"] != digest_of(row):
            fault = "it does not agree with its digest"
        return fault

    def _plain(self, table: Table, stored: sqlite3.Row) -> Row:
        row = {name: stored[name] for name in self._names(table)}
        if table == "units":
            for name, kind in self._types.items():
                if kind == "bool" and row[name] in (0, 1):
                    row[name] = bool(row[name])
        return row

    def _names(self, table: Table) -> tuple[str, ...]:
        return tuple(self._types) if table == "units" else ERROR_COLUMNS

    def _in_order(self, rows: list[Row]) -> list[Row]:
        return sorted(rows, key=lambda row: (self._cells[row["cell"]], row["index"]))

    def _sum_up(self, table: Table, number: int, digests: Sequence[str]) -> None:
        before = self._connection.execute("SELECT digest FROM sums WHERE name = ?", (table,)).fetchone()
        self._connection.execute(
            "UPDATE sums SET number = number + ?, digest = ? WHERE name = ?",
            (number, joint_digest([before["digest"], *digests]), table),
        )

    def _check_writable(self) -> None:
        (found,) = self._connection.execute("PRAGMA integrity_check(1)").fetchone()
        if found != "ok":
            raise InputError(str(self.path), f"is damaged ({found})", RERUN)
