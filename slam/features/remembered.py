"""What was found in an image, kept for the next time that the same image comes."""

from collections.abc import Callable
from hashlib import blake2b
from typing import Generic, TypeVar

import numpy as np

from slam.core.snapshot import Unchanging

Found = TypeVar("Found")


class Remembered(Unchanging, Generic[Found]):
    """Results by the content of the image, so that they do not depend on what came before.

    Copies of a system share it, as what it returns is what would be found anew.

    Args:
        most: number of images; the one used longest ago is forgotten first.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: dict[bytes, Found] = {}

    def of(self, image: np.ndarray, find: Callable[[np.ndarray], Found]) -> Found:
        """What ``find`` returns for an image, whose result depends on the image alone."""
        key = blake2b(np.ascontiguousarray(image), digest_size=16).digest()
        found = self._kept.pop(key, None)
        if found is None:
            found = find(image)
        self._kept[key] = found
        if len(self._kept) > self._most:
            del self._kept[next(iter(self._kept))]
        return found
