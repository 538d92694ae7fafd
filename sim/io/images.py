"""Images of a folder or an archive, read one by one on demand."""

import zipfile
from pathlib import Path

import cv2
import numpy as np

from scenarios.errors import InputError
from sim.io.layout import DEPTH_PER_M


class GrayFolder:
    """A ``FrameSource`` of gray images; colour ones are converted.

    Args:
        paths: the images.
        shape: (H, W) that every one must have.
        authority: file that states the shape, for the fault.
    """

    def __init__(self, paths: list[Path], shape: tuple[int, int], authority: str = "camera.yaml") -> None:
        self._paths, self._shape, self._authority = paths, shape, authority

    def __len__(self) -> int:
        return len(self._paths)

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W) uint8. Raises InputError if the image cannot be read or has another size."""
        return _checked(read_gray(self._paths[index]), str(self._paths[index]), self._shape, self._authority)


class GrayZip:
    """A ``FrameSource`` of the images in a zip archive, in the order of their names.

    Args:
        path: the archive.
        shape: (H, W) that every image must have.
        authority: file that states the shape, for the fault.

    Raises:
        InputError: it cannot be read as an archive.
    """

    def __init__(self, path: Path, shape: tuple[int, int], authority: str) -> None:
        self._path, self._shape, self._authority = path, shape, authority
        try:
            self._archive = zipfile.ZipFile(path)
        except (OSError, zipfile.BadZipFile):
            raise InputError(str(path), "is no readable zip archive", "copy it again") from None
        self._names = sorted(name for name in self._archive.namelist() if name.endswith((".jpg", ".png")))

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W) uint8. Raises InputError if the image cannot be read or has another size."""
        where = f"{self._path}: {self._names[index]}"
        try:
            data = np.frombuffer(self._archive.read(self._names[index]), np.uint8)
        except (OSError, zipfile.BadZipFile, zipfile.zlib.error):
            raise InputError(where, "cannot be unpacked", "copy the archive again") from None
        return _checked(_decoded(data, where, cv2.IMREAD_GRAYSCALE), where, self._shape, self._authority)


class DepthFolder:
    """A ``FrameSource`` of depth images, stored as 16-bit codes.

    Args:
        paths: the images, None for a frame without one.
        shape: (H, W) that every one must have.
    """

    def __init__(self, paths: list[Path | None], shape: tuple[int, int]) -> None:
        self._paths, self._shape = paths, shape

    def __len__(self) -> int:
        return len(self._paths)

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W) float32 metres, 0 for none. Raises InputError as ``GrayFolder`` does."""
        path = self._paths[index]
        if path is None:
            return np.zeros(self._shape, np.float32)
        code = _checked(read_raw(path), str(path), self._shape, "camera.yaml")
        if code.dtype != np.uint16:
            raise InputError(str(path), "is no 16-bit depth image", "write 16-bit gray PNG")
        return code.astype(np.float32) / np.float32(DEPTH_PER_M)


def read_gray(path: Path) -> np.ndarray:
    """(H, W) uint8 of an image file of any size. Raises InputError if it cannot be read."""
    return _decoded(_bytes(path), str(path), cv2.IMREAD_GRAYSCALE)


def read_raw(path: Path) -> np.ndarray:
    """The stored image, depth and channels unchanged. Raises InputError if unreadable."""
    return _decoded(_bytes(path), str(path), cv2.IMREAD_UNCHANGED)


def _bytes(path: Path) -> np.ndarray:
    try:
        return np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(str(path), error.strerror or "cannot be read", "copy the folder again") from None


def _decoded(data: np.ndarray, where: str, mode: int) -> np.ndarray:
    try:
        image = cv2.imdecode(data, mode) if len(data) else None
    except cv2.error:
        image = None
    if image is None:
        raise InputError(where, "is no readable image", "copy or write this image again")
    return image


def _checked(image: np.ndarray, where: str, shape: tuple[int, int], authority: str) -> np.ndarray:
    if image.shape != shape:
        height, width = shape
        problem = f"is {image.shape[1]}x{image.shape[0]} pixels, {authority} says {width}x{height}"
        raise InputError(where, problem, f"correct the size in {authority} or the image")
    return image
