"""Stacks of frames in one raw .npy file, written one by one, read memory-mapped."""

import weakref
import zipfile
import zlib
from pathlib import Path
from tokenize import TokenError
from types import TracebackType

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import open_file
from dslab.sim.cache import CorruptEntryError
from dslab.sim.unfinished import hold

UNREADABLE = (
    EOFError,
    KeyError,
    OSError,
    OverflowError,
    RuntimeError,
    SyntaxError,
    TokenError,
    ValueError,
    zipfile.BadZipFile,
    zlib.error,
)
"""What NumPy raises for files that are no array or archive of arrays, by the place of the damage."""


class RawWriter:
    """Context manager that writes (N, H, W), or (N, H, W, 3), frames one by one and checks their number.

    The file is written as a stream, not through a memory map, so that a full disk raises an error instead of
    killing the process.

    Args:
        path: .npy file to create.
        shape: (N, H, W) or (N, H, W, 3).
        dtype: of the frames.
    """

    def __init__(self, path: Path, shape: tuple[int, ...], dtype: type) -> None:
        self._shape, self._dtype, self._written = shape, np.dtype(dtype), 0
        self._file = path.open("wb")
        header = {"descr": np.lib.format.dtype_to_descr(self._dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(self._file, header)

    def __enter__(self) -> "RawWriter":
        return self

    def append(self, frame: np.ndarray) -> None:
        """Add one frame."""
        if frame.shape != self._shape[1:] or frame.dtype != self._dtype:
            raise ValueError(f"frame is {frame.shape} {frame.dtype}, stack is {self._shape} {self._dtype}")
        self._file.write(np.ascontiguousarray(frame).data)
        self._written += 1

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._file.close()
        if error is None and self._written != self._shape[0]:
            raise ValueError(f"{self._written} frames written, {self._shape[0]} announced")


class RawFrames:
    """A ``FrameSource`` over the file of a ``RawWriter``, in use as long as this exists.

    Raises:
        CorruptEntryError: the file holds anything else.
    """

    def __init__(self, path: Path, shape: tuple[int, ...], dtype: type) -> None:
        self._stack = stored_array(path, shape, dtype)
        held = path.open("rb")
        weakref.finalize(self, held.close)  # also if this ends in a cycle of references
        hold(held.fileno())

    def __len__(self) -> int:
        return len(self._stack)

    def __getitem__(self, index: int) -> np.ndarray:
        """A frame, a writable copy: kernels are compiled for such arrays."""
        return np.array(self._stack[index])


def stored_array(path: Path, shape: tuple[int | None, ...], dtype: type) -> np.ndarray:
    """Map the array of a .npy file, of a shape with None for a side of any length.

    Raises:
        CorruptEntryError: the file holds anything else.
    """
    try:
        array = np.load(path, mmap_mode="r")
    except UNREADABLE as error:
        raise CorruptEntryError(f"{path.name} is no array: {error}") from None
    alike = len(array.shape) == len(shape) and all(
        b is None or a == b for a, b in zip(array.shape, shape, strict=True)
    )
    if not alike or array.dtype != dtype:
        raise CorruptEntryError(f"{path.name} has shape {array.shape} of {array.dtype}")
    return array


def stored_archive(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an .npz file by name, in its order. Raises CorruptEntryError for anything else."""
    try:
        open_file(path).close()
        archive = np.load(path)
        if not isinstance(archive, np.lib.npyio.NpzFile):
            raise ValueError("no archive")
        with archive:
            return {name: archive[name] for name in archive.files}
    except (InputError, *UNREADABLE) as error:
        raise CorruptEntryError(f"{path.name} holds no arrays: {error}") from None


def stored_columns(path: Path, count: int) -> dict[str, np.ndarray]:
    """The (count,) float64 columns of an .npz file, by name, sorted. Raises as ``stored_archive``."""
    columns = dict(sorted(stored_archive(path).items()))
    for name, column in columns.items():
        if column.shape != (count,) or column.dtype != np.float64:
            raise CorruptEntryError(f"{path.name}: {name} has shape {column.shape} of {column.dtype}")
    return columns
