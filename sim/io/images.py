"""Images of a folder or an archive, read one by one on demand.

The size of an image is taken from its header and checked before a pixel is decoded.
"""

import os
import zipfile
import zlib
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path, PurePosixPath

import cv2
import numpy as np

from dslab.scenarios.errors import InputError, notice
from dslab.scenarios.input_files import IMAGE_BYTES, file_names, open_file, read_bytes
from dslab.sim.io.camera_file import check_size, other_size
from dslab.sim.io.image_header import header_size, is_whole, most_of_pnm
from dslab.sim.io.layout import DEPTH_PER_M
from dslab.sim.io.text import to_frame_number

_COPY = "copy the folder again"
# Of 256 levels; an image of 16 bits that fills fewer is not one of full range.
_LEAST_LEVELS = 64
_NOTED_BYTES = 1 << 16
_PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# Encryption, of either kind, and patches.
_CLOSED = 0x1 | 0x20 | 0x40


class GrayFolder:
    """A ``FrameSource`` of gray images; colour ones are converted, and kept for ``colour_frame``.

    Args:
        paths: the images.
        shape: (H, W) that every one must have.
        authority: file that states the shape, for the fault.

    Raises:
        InputError: the first of them cannot be read or has another size.
    """

    def __init__(self, paths: list[Path], shape: tuple[int, int], authority: str = "camera.yaml") -> None:
        self._paths, self._shape, self._authority = paths, shape, authority
        self._counts: tuple[float, float] | None = None
        if paths:
            first = self._raw(0)  # a wrong size shows in the first image already
            self._counts = self._range_of_counts() if first.dtype == np.uint16 else None
            _say_if_turned(paths[0], first)

    def __len__(self) -> int:
        return len(self._paths)

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W) uint8. Raises InputError if the image cannot be read or has another size."""
        path = self._paths[index]
        if self._counts is None:
            return _decoded(_bytes(path), str(path), cv2.IMREAD_GRAYSCALE, self._shape, self._authority)
        low, high = self._counts
        levels = (self._raw(index).astype(np.float32) - low) * (255 / (high - low))
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)

    def colour(self, index: int) -> np.ndarray:
        """See ``colour_frame``; errors as of a gray frame."""
        path = self._paths[index]
        image = _decoded(_bytes(path), str(path), cv2.IMREAD_ANYCOLOR, self._shape, self._authority)
        return self[index] if image.ndim == 2 or self._counts else image

    def _raw(self, index: int) -> np.ndarray:
        """(H, W) of the stored type."""
        path = self._paths[index]
        mode = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
        return _decoded(_bytes(path), str(path), mode, self._shape, self._authority)

    def _range_of_counts(self) -> tuple[float, float] | None:
        """Lowest and highest count of 16-bit images that fill a small part of their range; None for others.

        Cameras of 10 or 12 bits, and thermal ones, give such images; their highest eight bits hold little.
        """
        some = {0, len(self._paths) // 2, len(self._paths) - 1}
        ends = np.array([np.quantile(self._raw(index), (0.001, 0.999)) for index in some])
        low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
        if not 0 < high - low < _LEAST_LEVELS * 256:
            return None
        bits = [n for n in (10, 12, 14) if high < 2**n]
        if bits and high - low > 2 ** bits[0] / 8:
            low, high = 0.0, 2.0 ** bits[0] - 1
            notice(str(self._paths[0].parent), f"16-bit images hold {bits[0]} bits: they are read as such")
        else:
            text = f"counts {low:g} to {high:g} of 16-bit images are spread over 256 levels"
            notice(str(self._paths[0].parent), text)
        return low, high


class GrayZip:
    """A ``FrameSource`` of the images in a zip archive, in the order of their numbers.

    Args:
        path: the archive.
        shape: (H, W) that every image must have.
        authority: file that states the shape, for the fault.

    Raises:
        InputError: it cannot be read as an archive, or its images are not numbered.
    """

    def __init__(self, path: Path, shape: tuple[int, int], authority: str) -> None:
        self._path, self._shape, self._authority = path, shape, authority
        try:
            open_file(path, if_missing="add the images").close()
            self._archive = zipfile.ZipFile(path)
            entries = self._archive.infolist()
        except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile):
            raise InputError(str(path), "is no readable zip archive", "copy it again") from None
        images = {entry.filename: entry for entry in entries if entry.filename.endswith((".jpg", ".png"))}
        names = [entry.filename for entry in entries if entry.filename in images]
        self._entries = [images[name] for name in by_number(names, str(path))]
        for entry in self._entries:
            self._check_entry(entry)

    def __len__(self) -> int:
        return len(self._entries)

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W) uint8. Raises InputError if the image cannot be read or has another size."""
        return self._read(index, cv2.IMREAD_GRAYSCALE)

    def colour(self, index: int) -> np.ndarray:
        """See ``colour_frame``; errors as of a gray frame."""
        return self._read(index, cv2.IMREAD_ANYCOLOR)

    def _read(self, index: int, mode: int) -> np.ndarray:
        entry = self._entries[index]
        where = f"{self._path}: {entry.filename}"
        try:
            data = self._archive.read(entry)
        except (OSError, EOFError, ValueError, zipfile.BadZipFile, zlib.error):
            raise InputError(where, "cannot be unpacked", "copy the archive again") from None
        return _decoded(data, where, mode, self._shape, self._authority)

    def _check_entry(self, entry: zipfile.ZipInfo) -> None:
        """Raise InputError for an entry that would not unpack, or to more than an image takes."""
        where = f"{self._path}: {entry.filename}"
        if entry.flag_bits & _CLOSED or entry.compress_type not in _PACKINGS:
            raise InputError(where, "is encrypted or packed by an unusual method", "pack the images anew")
        if entry.file_size > IMAGE_BYTES:
            problem = (
                f"unpacks to {entry.file_size / 1e6:.0f} MB, an image takes at most {IMAGE_BYTES / 1e6:g}"
            )
            raise InputError(where, problem, "copy the archive again")


class DepthFolder:
    """A ``FrameSource`` of depth images, stored as 16-bit codes.

    Args:
        paths: the images, None for a frame without one.
        shape: (H, W) that every one must have.
        per_m: codes per metre.
        authority: file that states the shape, for the fault.
    """

    def __init__(
        self,
        paths: list[Path | None],
        shape: tuple[int, int],
        per_m: float = DEPTH_PER_M,
        authority: str = "camera.yaml",
    ) -> None:
        self._paths, self._shape, self._per_m, self._authority = paths, shape, per_m, authority

    def __len__(self) -> int:
        return len(self._paths)

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W) float32 metres, 0 for none. Raises InputError as ``GrayFolder`` does."""
        path = self._paths[index]
        if path is None:
            return np.zeros(self._shape, np.float32)
        code = read_raw(path, self._shape, self._authority)
        if code.dtype != np.uint16 or code.ndim != 2:
            raise InputError(str(path), "is no 16-bit depth image", "write 16-bit gray PNG")
        return code.astype(np.float32) / np.float32(self._per_m)


def read_raw(path: Path, shape: tuple[int, int], authority: str) -> np.ndarray:
    """The stored image, (H, W) or (H, W, C), depth and channels unchanged; errors as of ``GrayFolder``."""
    return _decoded(_bytes(path), str(path), cv2.IMREAD_UNCHANGED, shape, authority)


def decoded_gray(data: bytes, where: str, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) uint8 of the content of an image file; errors as of ``GrayFolder``."""
    return _decoded(data, where, cv2.IMREAD_GRAYSCALE, shape, "the first image")


def image_shape(path: Path) -> tuple[int, int]:
    """(H, W) of an image file, from its header. Raises InputError without one, or for a size not taken."""
    width, height = _header(_bytes(path), str(path))
    check_size(str(path), width, height)
    return height, width


def names_in(folder: Path, images: Sequence[Path]) -> tuple[str, ...]:
    """Names of image files relative to a folder, for ``Sequence.image_names``."""
    return tuple(os.path.relpath(image, folder) for image in images)


def numbered_images(folder: Path, suffixes: tuple[str, ...], ending: str = "") -> list[Path]:
    """The images of a folder in the order of their numbers. Raises InputError as ``by_number``."""
    names = [name for name in file_names(folder) if name.endswith(suffixes)]
    return [folder / name for name in by_number(names, str(folder), ending)]


def by_number(names: Sequence[str], where: str, ending: str = "") -> list[str]:
    """Names of images in the order of their numbers.

    Args:
        names: such as ``000017.png``, with any leading zeros or none, possibly in folders.
        where: folder or archive of them, for the fault.
        ending: what follows the number in every name.

    Raises:
        InputError: a name is no number, a number occurs twice or is missing between others.
    """
    numbered: list[tuple[int, str]] = []
    for name in names:
        word = PurePosixPath(name).stem.removesuffix(ending)
        numbered.append((to_frame_number(f"{where}: {name}", word), name))
    numbered.sort()
    for (before, _), (number, name) in pairwise(numbered):
        if number == before:
            raise InputError(f"{where}: {name}", f"number {number} occurs twice", "keep one of them")
        if number > before + 1:
            problem = f"image {before + 1} is missing before it"
            raise InputError(
                f"{where}: {name}", problem, "copy the folder again, or number them without gaps"
            )
    return [name for _, name in numbered]


def _bytes(path: Path) -> bytes:
    return read_bytes(path, IMAGE_BYTES, _COPY)


def _header(data: bytes, where: str) -> tuple[int, int]:
    size = header_size(data)
    if size is None or not all(size):
        raise InputError(where, "is no readable image", "copy or write it again, as PNG, JPEG, BMP or PGM")
    # OpenCV fills up what is lacking, without a word.
    if not is_whole(data):
        raise InputError(where, "is cut short or damaged", "copy or write this image again")
    return size


def _say_if_turned(path: Path, image: np.ndarray) -> None:
    """Say it where the note of a camera turns an image that is read as it is stored."""
    data = _bytes(path)
    if b"exif" not in data[:_NOTED_BYTES].lower():
        return
    turned = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    if turned is not None and not np.array_equal(turned, image):
        notice(
            str(path), "its EXIF note turns it: images count as stored, as their size is the calibration's"
        )


def _decoded(data: bytes, where: str, mode: int, shape: tuple[int, int], authority: str) -> np.ndarray:
    size = _header(data, where)
    # A note in the header may say how to turn the image; the intrinsics are of it as stored, or turned.
    turned = size == shape != size[::-1] and b"exif" in data[:_NOTED_BYTES].lower()
    if size != shape[::-1] and not turned:
        raise other_size(where, size, shape, authority)
    most = most_of_pnm(data)
    odd = mode != cv2.IMREAD_UNCHANGED and most not in (0, 255, 65535)
    read = mode | (0 if turned or mode == cv2.IMREAD_UNCHANGED else cv2.IMREAD_IGNORE_ORIENTATION)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), read | (cv2.IMREAD_ANYDEPTH if odd else 0))
    except cv2.error:
        image = None
    if image is None:
        raise InputError(where, "is no readable image", "copy or write this image again")
    if image.shape[:2] != shape:
        raise other_size(where, (image.shape[1], image.shape[0]), shape, authority)
    if odd:
        kind = image.dtype if mode & cv2.IMREAD_ANYDEPTH else np.uint8
        full = np.iinfo(kind).max
        image = np.clip(np.rint(image.astype(np.float32) * (full / most)), 0, full).astype(kind)
    return image
