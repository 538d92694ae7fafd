"""Result folders that are whole or not there: written beside, then renamed."""

import errno
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from scenarios.errors import InputError

_FULL = {errno.ENOSPC, errno.EDQUOT}


@contextmanager
def new_directory(out_dir: Path, replaces_marker: str | None = None) -> Iterator[Path]:
    """A folder to write results into, which becomes ``out_dir`` when the block ends well.

    Whatever ends the block otherwise leaves nothing behind.

    Args:
        out_dir: where the results shall be; absent or an empty folder.
        replaces_marker: a folder that holds a file of this name is an earlier result and may be replaced.

    Raises:
        InputError: the place is taken or not writable, or the disk is full.
    """
    out_dir = Path(out_dir)
    check_free(out_dir, replaces_marker)
    made = _missing_parents(out_dir)
    try:
        out_dir.parent.mkdir(parents=True, exist_ok=True)
        partial = out_dir.parent / f".{out_dir.name}.partial-{uuid4().hex[:8]}"
        partial.mkdir()
    except OSError as error:
        _remove_empty(made)
        raise InputError(
            str(out_dir), f"cannot be created ({error.strerror})", "choose a folder you may write to"
        ) from None
    try:
        yield partial
        _put_in_place(partial, out_dir)
    except BaseException as error:
        shutil.rmtree(partial, ignore_errors=True)
        _remove_empty(made)
        if isinstance(error, OSError):
            _raise_as_input_error(error, out_dir, partial)
        raise


def check_free(out_dir: Path, replaces_marker: str | None = None) -> None:
    """Make sure, before long work, that a result folder may be put there. Arguments as `new_directory`."""
    if not out_dir.exists():
        return
    if not out_dir.is_dir():
        raise InputError(str(out_dir), "is a file, not a folder", "choose another folder")
    try:
        taken = any(out_dir.iterdir())
    except OSError as error:
        raise InputError(
            str(out_dir), f"cannot be read ({error.strerror})", "choose another folder"
        ) from None
    if taken and not (replaces_marker and (out_dir / replaces_marker).is_file()):
        raise InputError(str(out_dir), "already holds files", "choose a new folder, or empty this one first")


def _put_in_place(partial: Path, out_dir: Path) -> None:
    if not out_dir.exists():
        partial.rename(out_dir)
        return
    # The earlier result is moved aside first, so that an interruption leaves one of the two whole.
    old = partial.with_name(partial.name + "-old")
    out_dir.rename(old)
    try:
        partial.rename(out_dir)
    except OSError:
        old.rename(out_dir)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _missing_parents(out_dir: Path) -> list[Path]:
    return [p for p in out_dir.absolute().parents if not p.exists()]


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return


def _raise_as_input_error(error: OSError, out_dir: Path, partial: Path) -> None:
    """Turn a failure to write the results into one clear line; let every other one pass."""
    if error.errno in _FULL:
        raise InputError(
            str(out_dir), "the disk is full", "free some space or choose another disk"
        ) from error
    at = str(error.filename or "")
    if at.startswith((str(partial), str(out_dir))):
        raise InputError(
            str(out_dir), f"cannot be written ({error.strerror})", "choose another folder"
        ) from error
