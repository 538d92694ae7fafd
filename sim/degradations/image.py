"""Interface of degradations that act on images, frame by frame."""

from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar, Protocol, TypeVar

import numpy as np

from dslab.scenarios.segments import ImageSegment
from dslab.sim.degradations.base import Kind
from dslab.sim.link import View
from dslab.sim.sensors.camera import Intrinsics

Streams = Callable[..., np.random.Generator]
"""Gives the random stream of one segment for a consumer's names."""

SegmentT = TypeVar("SegmentT", bound=ImageSegment)


class Filter(Protocol):
    """One segment, prepared for a camera."""

    def __call__(self, image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
        """Return the degraded frame and its measure, in the unit of the kind.

        Args:
            image: (H, W) uint8, left unchanged; may be returned itself if nothing changes.
            view: further data of the frame.
        """
        ...


class ImageDegradation(Kind[SegmentT]):
    """A kind that acts on images; see ``Kind``.

    Attributes:
        needs_depth: frames need a depth image.
        needs_motion: frames need the camera's motion.
        is_drawn: chance has a part in it; False if its filter takes no number from its streams.
        takes_colour: its filter takes a frame in colour, (H, W, 3), as a whole. Others are given each of its
            channels as an image, with ``View.channel``.
    """

    needs_depth: ClassVar[bool] = False
    needs_motion: ClassVar[bool] = False
    is_drawn: ClassVar[bool] = True
    takes_colour: ClassVar[bool] = False

    @abstractmethod
    def prepare(self, segment: SegmentT, camera: Intrinsics, streams: Streams) -> Filter:
        """Prepare the segment: compute once everything that is the same for all frames."""
