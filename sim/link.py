"""The links of the imaging chain: each changes the image of a frame, from the surfaces to the stored file."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from dslab.sim.motion.base import Motion

USUAL_EXPOSURE_S = 0.01


class Shutter(NamedTuple):
    """Poses of the camera while the shutter is open, (4, 4) float64 each.

    Attributes:
        T_world_mid: camera to world at the centre of the exposure.
        T_mid_open: camera at the shutter's opening to camera at its centre.
        T_mid_close: the same for its closing.
    """

    T_world_mid: np.ndarray
    T_mid_open: np.ndarray
    T_mid_close: np.ndarray


@dataclass(frozen=True)
class View:
    """Data of a frame besides its image.

    Attributes:
        frame: its number before any frame was dropped.
        stamp_s: true centre of its exposure.
        strength: position on the segment's ramp, above 0 to 1; severity grows in proportion.
        depth_m: (H, W) float32 depth along the optical axis, 0 for none; None where unknown, or
            behind the lens.
        motion: the camera's motion; None where unknown and behind the lens.
        exposure_s: shutter time; a usual one where unknown.
        index: its place in the sequence.
        shutter: poses during the exposure; None in a recording.
        channel: which channel of a frame in colour the image is; None for a gray frame.
    """

    frame: int
    stamp_s: float
    strength: float = 1.0
    depth_m: np.ndarray | None = None
    motion: Motion | None = None
    exposure_s: float = USUAL_EXPOSURE_S
    index: int = 0
    shutter: Shutter | None = None
    channel: int | None = None

    @property
    def noise_names(self) -> tuple[int, ...]:
        """Names of a random stream for this image alone: each channel has noise of its own."""
        return (self.frame,) if self.channel is None else (self.frame, self.channel)


class Link(Protocol):
    """One step of a frame's image, made once for all frames of a plan."""

    def apply(self, image: np.ndarray, view: View) -> tuple[np.ndarray, View]:
        """Return the image after this step and the data of the frame.

        Args:
            image: (H, W) uint8, left unchanged; may be returned itself. The first link gets an empty one.
            view: further data of the frame.
        """
        ...


NO_IMAGE = np.empty((0, 0), np.uint8)


def fold(links: Iterable[Link], image: np.ndarray, view: View) -> tuple[np.ndarray, View]:
    """Return the image and the data of a frame after all links, one after the other."""
    for link in links:
        image, view = link.apply(image, view)
    return image, view
