"""One driver at a time per experiment folder."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from scenarios.errors import InputError

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
        with closing(sqlite3.connect(folder / LOCK_FILE, timeout=0.0, isolation_level=None)) as lock:
            lock.execute("BEGIN EXCLUSIVE")
            yield
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode == sqlite3.SQLITE_BUSY:
            raise InputError(
                str(folder),
                "another run is at work in this folder",
                "wait for its end or choose another folder",
            ) from None
        raise InputError(
            str(folder), f"cannot be locked ({error})", "choose a folder you may write to"
        ) from None
