"""Folders that are written wholly or not at all."""

import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2

from scenarios.errors import InputError
from sim.sequence import FrameSource

Progress = Callable[[str, int, int], None]
"""Called with the name of the step, frames done and frames in all."""

_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


def claim_output_dir(directory: Path) -> None:
    """See that a folder can be made there, before the work that is to go into it.

    Raises:
        InputError: it is a file or a folder that is not empty, or the place cannot be written.
    """
    if directory.exists() and not directory.is_dir():
        raise InputError(str(directory), "is a file", "give the path of a new or empty folder")
    if directory.is_dir() and any(directory.iterdir()):
        raise InputError(str(directory), "the folder is not empty", "give another one or empty it")
    try:
        directory.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=directory.parent):
            pass
        if directory.is_dir():
            with tempfile.TemporaryFile(dir=directory):
                pass
    except OSError as error:
        raise _unwritable(directory, error) from error


@contextmanager
def whole_or_nothing(directory: Path) -> Iterator[Path]:
    """A folder beside the wanted one that takes its name when the block ends, and vanishes if it raises.

    Raises:
        InputError: the place is taken or cannot be written, the disk is full; nothing is left behind.
    """
    directory = directory.resolve()
    claim_output_dir(directory)
    # Made by mkdir and not as a temporary folder, which nobody else could read.
    unfinished = directory.parent / f".{directory.name}.unfinished-{os.getpid()}-{secrets.token_hex(4)}"
    try:
        unfinished.mkdir()
    except OSError as error:
        raise _unwritable(directory, error) from error
    try:
        yield unfinished
        if directory.is_dir():
            directory.rmdir()
        os.replace(unfinished, directory)
    except OSError as error:
        raise _unwritable(directory, error) from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def write_images(images: FrameSource, paths: list[Path], step: str, progress: Progress | None = None) -> None:
    """Write one PNG per path; the folder must exist.

    Raises:
        OSError: an image cannot be encoded or written.
    """
    for frame, path in enumerate(paths):
        encoded, data = cv2.imencode(".png", images[frame], _FAST_PNG)
        if not encoded:
            raise OSError(f"frame {frame} cannot be encoded")
        path.write_bytes(data.tobytes())
        if progress:
            progress(step, frame + 1, len(paths))


def _unwritable(directory: Path, error: OSError) -> InputError:
    problem = f"cannot be written ({error.strerror or error})"
    return InputError(str(directory), problem, "free space or give another folder")
