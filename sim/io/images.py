"""Images of a folder, read one by one when they are needed."""

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
    """

    def __init__(self, paths: list[Path], shape: tuple[int, int]) -> None:
        self._paths, self._shape = paths, shape

    def __len__(self) -> int:
        return len(self._paths)

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W) uint8. Raises InputError if the image cannot be read or has another size."""
        return _read(self._paths[index], self._shape, cv2.IMREAD_GRAYSCALE)


class DepthFolder:
    """A ``FrameSource`` of depth images, stored as 16-bit codes.

    Args:
        paths: the images.
        shape: (H, W) that every one must have.
    """

    def __init__(self, paths: list[Path], shape: tuple[int, int]) -> None:
        self._paths, self._shape = paths, shape

    def __len__(self) -> int:
        return len(self._paths)

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W) float32 metres, 0 for none. Raises InputError as ``GrayFolder`` does."""
        code = _read(self._paths[index], self._shape, cv2.IMREAD_UNCHANGED)
        if code.dtype != np.uint16:
            raise InputError(str(self._paths[index]), "is no 16-bit depth image", "write 16-bit gray PNG")
        return code.astype(np.float32) / np.float32(DEPTH_PER_M)


def _read(path: Path, shape: tuple[int, int], mode: int) -> np.ndarray:
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(str(path), error.strerror or "cannot be read", "copy the folder again") from None
    try:
        image = cv2.imdecode(data, mode) if len(data) else None
    except cv2.error:
        image = None
    if image is None:
        raise InputError(str(path), "is no readable image", "copy or write this image again")
    if image.shape != shape:
        height, width = shape
        problem = f"is {image.shape[1]}x{image.shape[0]} pixels, camera.yaml says {width}x{height}"
        raise InputError(str(path), problem, "correct width and height in camera.yaml or the image")
    return image
