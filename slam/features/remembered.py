"""What was found in an image, kept for the next time that the same image comes."""

from collections.abc import Callable, Hashable
from hashlib import blake2b
from typing import Generic, TypeVar

import numpy as np

from dslab.slam.core.snapshot import Immutable

Found = TypeVar("Found")


class Remembered(Immutable, Generic[Found]):
    """Results by the content of the image, so that they do not depend on what came before.

    Copies of a system share it, as what it returns is what would be found anew.

    Args:
        most: number of results; the one used longest ago is forgotten first.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: dict[tuple[bytes, Hashable], Found] = {}

    def of(self, image: np.ndarray, find: Callable[[np.ndarray], Found], kind: Hashable = None) -> Found:
        """What ``find`` returns for an image.

        Args:
            image: any array of bytes.
            find: its result, which nobody may change, depends on image and kind alone.
            kind: what is sought, with all its settings.
        """
        key = blake2b(np.ascontiguousarray(image), digest_size=16).digest(), kind
        found = self._kept.pop(key, None)
        if found is None:
            found = find(image)
        self._kept[key] = found
        if len(self._kept) > self._most:
            del self._kept[next(iter(self._kept))]
        return found
