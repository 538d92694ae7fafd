"""Folders of work under way, each locked by its process: what a killed one leaves is known and swept."""

import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

try:
    import fcntl
except ImportError:  # without locks, nothing is ever taken for dead
    fcntl = None

SCRATCH = "dslab-"
_LOCK = ".dslab-lock"
_DIGITS = 12
_own: set[Path] = set()


@contextmanager
def unfinished_folder(parent: Path, prefix: str) -> Iterator[Path]:
    """Yield a new folder to work in, which vanishes when the block ends; what is to stay is moved out of it.

    A process that is killed leaves its folder. The next one to make a folder of this name removes it.

    Args:
        parent: existing folder.
        prefix: start of the name.

    Raises:
        OSError: the parent cannot be written.
    """
    sweep(parent, prefix)
    home, lock = _claimed(parent.absolute(), prefix)
    try:
        work = home / "work"
        work.mkdir()
        yield work
    finally:
        _remove(home)
        os.close(lock)


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield a new folder on the temporary disk, which vanishes when the block ends."""
    with unfinished_folder(Path(tempfile.gettempdir()), SCRATCH) as folder:
        yield folder


def sweep_scratch() -> None:
    """Remove the scratch folders of processes that are dead."""
    sweep(Path(tempfile.gettempdir()), SCRATCH)


def sweep(parent: Path, prefix: str) -> None:
    """Remove the unfinished folders of processes that are dead; those of others and at work stay."""
    with suppress(OSError), os.scandir(parent) as entries:
        for entry in entries:
            if re.fullmatch(rf"{re.escape(prefix)}[0-9a-f]{{{_DIGITS}}}", entry.name) and _is_ours(entry):
                _remove_dead(Path(entry.path))


def remove_own() -> None:
    """Remove what this process has not removed because an interruption came at the wrong moment."""
    for home in list(_own):
        _remove(home)


def hold(file: int) -> None:
    """Mark an open file as in use, until it is closed; see ``is_held``."""
    take_lock(file, shared=True)


def is_held(path: Path) -> bool:
    """Return True if a file is known to be in use by a process, this one included."""
    try:
        with path.open("rb") as file:
            return take_lock(file.fileno()) is False
    except OSError:
        return False


def _claimed(parent: Path, prefix: str) -> tuple[Path, int]:
    """A new folder with its lock. Between their making and the locking another process may sweep it."""
    while True:
        home = parent / f"{prefix}{uuid4().hex[:_DIGITS]}"
        _own.add(home)
        try:
            home.mkdir(mode=0o700)
            lock = os.open(home / _LOCK, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600)
        except OSError as error:
            _remove(home)
            if isinstance(error, FileNotFoundError) and parent.is_dir():
                continue
            raise
        if take_lock(lock) is not False and os.fstat(lock).st_nlink:
            return home, lock
        os.close(lock)
        _own.discard(home)


def take_lock(file: int, shared: bool = False) -> bool | None:
    """Lock a file: True if it was free, False if it is held, None if there are no locks here.

    Several processes may hold a file that each of them locks as ``shared``.
    """
    try:
        if fcntl is None:
            return None
        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # some network file systems
        return None
    return True


def _is_ours(entry: os.DirEntry) -> bool:
    is_folder = entry.is_dir(follow_symlinks=False)
    return is_folder and (os.name != "posix" or entry.stat(follow_symlinks=False).st_uid == os.geteuid())


def _remove_dead(home: Path) -> None:
    try:
        lock = os.open(home / _LOCK, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
    except FileNotFoundError:
        # Killed before it was locked, or after it was emptied.
        with suppress(OSError):
            home.rmdir()
        return
    except OSError:
        return
    try:
        if take_lock(lock):
            _remove(home)
    finally:
        os.close(lock)


def _remove(home: Path) -> None:
    """Delete a folder, its lock last: whatever ends this, the rest is swept later."""
    work = home / "work"
    shutil.rmtree(work, ignore_errors=True)
    with suppress(OSError):
        if not work.exists():
            (home / _LOCK).unlink(missing_ok=True)
            home.rmdir()
    _own.discard(home)
