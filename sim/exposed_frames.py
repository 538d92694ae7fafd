"""Exposed frames that this process has rendered, shared by sequences that differ in some frames only.

Outside the stress the cells of an experiment see the same: of a sequence with other segments only the frames
that these touch are rendered and exposed anew.
"""

import hashlib
from dataclasses import dataclass

import numpy as np

from dslab.sim.degradations.base import FramePlan

MOST_BYTES = 64_000_000
"""Size of the frames that are kept; those used longest ago are dropped."""


@dataclass(frozen=True)
class Exposed:
    """A frame as it comes through the lens.

    Attributes:
        image: (H, W) uint8, never changed.
        blur_px: median length of its motion blur.
    """

    image: np.ndarray
    blur_px: float


_kept: dict[bytes, Exposed] = {}


class ExposedFrames:
    """Exposed frames of one world through one camera.

    Args:
        key: of all else that they depend on.
        plan: how the world's surfaces look.
    """

    def __init__(self, key: str, plan: FramePlan) -> None:
        looks = (plan.contrast, plan.texture_of, plan.period_m)
        self._world = key.encode() + b"".join(a.tobytes() for a in looks)

    def key(self, *poses: np.ndarray) -> bytes:
        """Key of the frame with these poses (4, 4) during its exposure."""
        return hashlib.sha256(self._world + b"".join(pose.tobytes() for pose in poses)).digest()

    def find(self, key: bytes) -> Exposed | None:
        """The frame of a key, if it is kept."""
        found = _kept.pop(key, None)
        if found is not None:
            _kept[key] = found
        return found

    def keep(self, key: bytes, image: np.ndarray, blur_px: float) -> None:
        """Keep a frame."""
        image.flags.writeable = False
        _kept[key] = Exposed(image, blur_px)
        while len(_kept) * image.nbytes > MOST_BYTES:
            del _kept[next(iter(_kept))]
