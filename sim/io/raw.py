"""Stacks of frames in one raw .npy file, written one by one, read memory-mapped."""

from pathlib import Path
from types import TracebackType

import numpy as np


class RawWriter:
    """Context manager that writes (N, H, W) frames one by one and checks their number.

    The file is written as a stream, not through a memory map, so that a full disk raises an error instead of
    killing the process.

    Args:
        path: .npy file to create.
        shape: (N, H, W).
        dtype: of the frames.
    """

    def __init__(self, path: Path, shape: tuple[int, int, int], dtype: type) -> None:
        self._shape, self._dtype, self._written = shape, np.dtype(dtype), 0
        self._file = path.open("wb")
        header = {"descr": np.lib.format.dtype_to_descr(self._dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(self._file, header)

    def __enter__(self) -> "RawWriter":
        return self

    def append(self, frame: np.ndarray) -> None:
        """Add one (H, W) frame."""
        if frame.shape != self._shape[1:] or frame.dtype != self._dtype:
            raise ValueError(f"frame is {frame.shape} {frame.dtype}, stack is {self._shape} {self._dtype}")
        self._file.write(np.ascontiguousarray(frame).data)
        self._written += 1

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._file.close()
        if error is None and self._written != self._shape[0]:
            raise ValueError(f"{self._written} frames written, {self._shape[0]} announced")


class RawFrames:
    """A ``FrameSource`` over the file of a ``RawWriter``."""

    def __init__(self, path: Path) -> None:
        self._stack = np.load(path, mmap_mode="r")

    def __len__(self) -> int:
        return len(self._stack)

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W), a writable copy: kernels are compiled for such arrays."""
        return np.array(self._stack[index])
