"""Folders and files that are written whole or not at all: beside their place, then renamed."""

import errno
import os
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any

import cv2

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_folder, is_given
from dslab.sim.sequence import FrameSource
from dslab.sim.unfinished import SCRATCH, unfinished_folder

Progress = Callable[[str, int, int], None]
"""Called with the name of the step, frames done and frames in all."""

_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]
_AGAIN = "and run the same command again"
_FULL = {
    errno.ENOSPC: ("the disk is full", f"free some space {_AGAIN}"),
    errno.EDQUOT: ("the disk is full", f"free some space {_AGAIN}"),
    errno.EFBIG: ("a file would be larger than the limit of this shell", f"raise `ulimit -f` {_AGAIN}"),
}
_TAKEN = {errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR}
_SHORT, _LONG_BYTES = 48, 240


def check_free(out_dir: Path, replaces: str | None = None) -> None:
    """Check before long work that a folder can be put in a place. Arguments as `new_directory`.

    Raises:
        InputError: it is a file or a folder that is not empty, or the place cannot be written.
    """
    out_dir = Path(out_dir)
    if "\0" in str(out_dir):
        raise InputError(str(out_dir), "is no possible name of a folder", "choose another folder")
    if is_given(out_dir) and not is_folder(out_dir):
        raise InputError(str(out_dir), "is a file, not a folder", "choose another folder")
    if os.path.ismount(out_dir):
        raise InputError(str(out_dir), "is a mount point, which cannot be replaced", "choose a folder in it")
    made = _missing_parents(out_dir)
    try:
        earlier = replaces is not None and any(path.is_file() for path in out_dir.glob(replaces))
        if out_dir.is_dir() and any(out_dir.iterdir()) and not earlier:
            remedy = "choose a new folder, or empty this one first"
            raise InputError(str(out_dir), "already holds files", remedy)
        out_dir.parent.mkdir(parents=True, exist_ok=True)
        place = out_dir.resolve()
        with unfinished_folder(place.parent, _partial(place)):
            pass
    except OSError as error:
        raise unwritable(out_dir, error) from error
    finally:
        _remove_empty(made)


@contextmanager
def new_directory(out_dir: Path, replaces: str | None = None) -> Iterator[Path]:
    """Yield a folder to write into, which becomes ``out_dir`` when the block ends without an error.

    If the block raises, nothing is left behind. If something else has come to the place meanwhile, both stay.

    Args:
        out_dir: an absent or empty folder.
        replaces: pattern of file names; a folder with a matching file is an earlier result and is replaced.

    Raises:
        InputError: the place is taken or cannot be written, or the disk is full.
    """
    check_free(out_dir, replaces)
    place = Path(out_dir).resolve()
    earlier = {} if replaces is None else _content(place)
    with _folder_beside(out_dir, _partial(place)) as partial:
        yield partial
        _put_in_place(partial, place, earlier)


@contextmanager
def scratch_beside(out_dir: Path) -> Iterator[Path]:
    """Yield a scratch folder on the disk of a result; the temporary disk may be too small.

    Raises:
        InputError: it cannot be written, or the disk is full.
    """
    with _folder_beside(out_dir, f".{SCRATCH}") as folder:
        yield folder


def write_file(path: Path, write: Callable[[Path], Any]) -> None:
    """Write a file that is whole, or stays as it was.

    Args:
        path: in an existing folder.
        write: called with the path to write to, a file of the same name in another folder.

    Raises:
        InputError: it cannot be written, or the disk is full.
    """
    try:
        with unfinished_folder(path.parent, _partial(path)) as folder:
            write(folder / path.name)
            (folder / path.name).replace(path)
    except OSError as error:
        raise unwritable(path, error) from error


def unwritable(path: Path, error: OSError) -> InputError:
    """The error to raise if a file or folder cannot be written."""
    if error.errno in _FULL:
        return InputError(str(path), *_FULL[error.errno])
    problem = f"cannot be written ({error.strerror or error})"
    return InputError(str(path), problem, "make it writable or choose another folder")


def subfolder(folder: Path, name: str) -> Path:
    """A folder in an existing one, made unless it is there.

    Raises:
        InputError: a file has its name, or it cannot be made.
    """
    place = folder / name
    try:
        place.mkdir(exist_ok=True)
    except FileExistsError:
        raise InputError(str(place), "is a file where a folder belongs", "move it away") from None
    except OSError as error:
        raise unwritable(place, error) from error
    return place


def write_images(images: FrameSource, paths: list[Path], step: str, progress: Progress | None = None) -> None:
    """Write one PNG per path; the folder must exist.

    Raises:
        OSError: an image cannot be encoded or written.
    """
    for frame, path in enumerate(paths):
        encoded, data = cv2.imencode(".png", images[frame], _FAST_PNG)
        if not encoded:
            raise OSError(errno.EINVAL, f"frame {frame} cannot be encoded", str(path))
        path.write_bytes(data.tobytes())
        if progress:
            progress(step, frame + 1, len(paths))


def _partial(place: Path) -> str:
    """Start of the name of what is being written; the longest names leave no room for more."""
    return f".{place.name[:_SHORT]}.partial-"


@contextmanager
def _folder_beside(out_dir: Path, prefix: str) -> Iterator[Path]:
    place = Path(out_dir).resolve()
    made = _missing_parents(place)
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with unfinished_folder(place.parent, prefix) as folder:
            yield folder
    except OSError as error:
        # An error in another place, such as an input file, is not the folder's.
        at, own = str(error.filename or ""), str(place.parent / prefix)
        if error.errno in _FULL or at.startswith((own, str(place))):
            raise unwritable(out_dir, error) from error
        raise
    finally:
        _remove_empty(made)


def _put_in_place(partial: Path, place: Path, earlier: dict[str, Any]) -> None:
    """Rename the finished folder, over nothing but an empty folder or the content of the start."""
    aside = _renamed_beside(place, place) if earlier and place.is_dir() else None
    try:
        if aside is not None and _content(aside) != earlier:
            raise FileExistsError(errno.EEXIST, "has changed", str(place))
        partial.rename(place)
    except BaseException as error:
        if aside is not None:
            with suppress(OSError):  # taken as well: it stays beside
                aside.rename(place)
        if not isinstance(error, OSError) or error.errno not in _TAKEN:
            raise
        kept = _renamed_beside(partial, place)
        problem = "has been taken or changed during the work, and is left as it is"
        raise InputError(str(place), problem, f"the finished result is in {kept}") from error
    if aside is not None:
        shutil.rmtree(aside, ignore_errors=True)


def _renamed_beside(folder: Path, place: Path) -> Path:
    """Rename a folder to the first free name of the kind ``place-2``."""
    stem = place.name if len(os.fsencode(place.name)) < _LONG_BYTES else place.name[:_SHORT]
    for number in count(2):
        name = place.with_name(f"{stem}-{number}")
        try:
            if not os.path.lexists(name):
                return folder.rename(name)
        except OSError as error:
            if error.errno not in _TAKEN:
                raise
    raise AssertionError


def _content(folder: Path) -> dict[str, Any]:
    """What tells whether the files below a folder have changed, by their paths; empty if it is absent."""
    found = {}
    for path in sorted(folder.rglob("*")):
        state = path.lstat()
        is_folder = stat.S_ISDIR(state.st_mode)
        found[str(path)[len(str(folder)) :]] = (
            None if is_folder else (state.st_ino, state.st_size, state.st_mtime_ns)
        )
    return found


def _missing_parents(folder: Path) -> list[Path]:
    return [parent for parent in folder.absolute().parents if not is_given(parent)]


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return
