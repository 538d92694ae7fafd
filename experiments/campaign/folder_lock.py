"""One driver at a time per experiment folder."""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from dslab.scenarios.errors import InputError

LOCK_FILE = "driver.lock"


@contextmanager
def sole_driver(folder: Path) -> Iterator[None]:
    """Lock the folder for this process; the lock is released when the process ends, even if killed.

    It is an SQLite lock on a separate file: these work on every platform and leave the ledger free for
    readers.

    Raises:
        InputError: another process holds the lock, or the folder cannot be written.
    """
    try:
        lock = _locked(folder / LOCK_FILE)
    except sqlite3.DatabaseError as error:
        if error.sqlite_errorcode == sqlite3.SQLITE_BUSY:
            raise InputError(
                str(folder),
                "another run is at work in this folder",
                "wait for its end or choose another folder",
            ) from None
        problem = f"cannot be locked ({error})"
        raise InputError(str(folder), problem, "choose a folder you may write to") from None
    with closing(lock):
        yield


def _locked(path: Path) -> sqlite3.Connection:
    lock = sqlite3.connect(path, timeout=0.0, isolation_level=None)
    try:
        try:
            lock.execute("BEGIN EXCLUSIVE")
        except sqlite3.DatabaseError as error:
            if error.sqlite_errorcode not in (sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CORRUPT):
                raise
            # The file holds nothing; something else was written over it. Nobody holds its lock.
            os.truncate(path, 0)
            lock.execute("BEGIN EXCLUSIVE")
    except BaseException:
        lock.close()
        raise
    return lock
