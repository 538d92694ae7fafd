"""Folders and files that are written whole or not at all: beside their place, then renamed."""

import errno
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

import cv2

from scenarios.errors import InputError
from scenarios.input_files import is_folder, is_given
from sim.sequence import FrameSource

Progress = Callable[[str, int, int], None]
"""Called with the name of the step, frames done and frames in all."""

_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]
_FULL = {errno.ENOSPC, errno.EDQUOT}


def check_free(out_dir: Path, replaces: str | None = None) -> None:
    """Check before long work that a folder can be put in a place. Arguments as `new_directory`.

    Raises:
        InputError: it is a file or a folder that is not empty, or the place cannot be written.
    """
    if "\0" in str(out_dir):
        raise InputError(str(out_dir), "is no possible name of a folder", "choose another folder")
    if is_given(out_dir) and not is_folder(out_dir):
        raise InputError(str(out_dir), "is a file, not a folder", "choose another folder")
    made = _missing_parents(out_dir)
    try:
        earlier = replaces is not None and any(path.is_file() for path in out_dir.glob(replaces))
        if out_dir.is_dir() and any(out_dir.iterdir()) and not earlier:
            remedy = "choose a new folder, or empty this one first"
            raise InputError(str(out_dir), "already holds files", remedy)
        out_dir.parent.mkdir(parents=True, exist_ok=True)
        for place in filter(Path.is_dir, (out_dir.parent, out_dir)):
            # As long a name as that of the unfinished folder.
            with tempfile.TemporaryDirectory(prefix=f".{out_dir.name}.partial-", dir=place):
                pass
    except OSError as error:
        raise unwritable(out_dir, error) from error
    finally:
        _remove_empty(made)


@contextmanager
def new_directory(out_dir: Path, replaces: str | None = None) -> Iterator[Path]:
    """Yield a folder to write into, which becomes ``out_dir`` when the block ends without an error.

    If the block raises, nothing is left behind.

    Args:
        out_dir: an absent or empty folder.
        replaces: pattern of file names; a folder with a matching file is an earlier result and is replaced.

    Raises:
        InputError: the place is taken or cannot be written, or the disk is full.
    """
    check_free(Path(out_dir), replaces)
    place = Path(out_dir).resolve()
    made = _missing_parents(place)
    # Made by mkdir and not as a temporary folder, which other users could not read.
    partial = place.parent / f".{place.name}.partial-{uuid4().hex[:8]}"
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        partial.mkdir()
    except OSError as error:
        _remove_empty(made)
        raise unwritable(out_dir, error) from error
    try:
        yield partial
        _put_in_place(partial, place)
    except BaseException as error:
        shutil.rmtree(partial, ignore_errors=True)
        _remove_empty(made)
        # An error in another place, such as an input file, is not the folder's.
        at = str(getattr(error, "filename", None) or "")
        if isinstance(error, OSError) and (error.errno in _FULL or at.startswith((str(partial), str(place)))):
            raise unwritable(out_dir, error) from error
        raise


def write_file(path: Path, write: Callable[[Path], Any]) -> None:
    """Write a file that is whole, or stays as it was.

    Args:
        path: in an existing folder.
        write: called with the path to write to, in the same folder and with the same suffix.

    Raises:
        InputError: it cannot be written, or the disk is full.
    """
    partial = path.with_name(f".{path.stem}.partial-{uuid4().hex[:8]}{path.suffix}")
    try:
        write(partial)
        os.replace(partial, path)
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        partial.unlink(missing_ok=True)


def unwritable(path: Path, error: OSError) -> InputError:
    """The error to raise if a file or folder cannot be written."""
    if error.errno in _FULL:
        return InputError(str(path), "the disk is full", "free some space and run the same command again")
    problem = f"cannot be written ({error.strerror or error})"
    return InputError(str(path), problem, "make it writable or choose another folder")


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


def _put_in_place(partial: Path, place: Path) -> None:
    if not place.exists():
        partial.rename(place)
        return
    # The earlier folder is moved aside first, so that an interruption leaves one of the two whole.
    old = partial.with_name(partial.name + "-old")
    place.rename(old)
    try:
        partial.rename(place)
    except OSError:
        old.rename(place)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _missing_parents(folder: Path) -> list[Path]:
    return [parent for parent in folder.absolute().parents if not is_given(parent)]


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return
