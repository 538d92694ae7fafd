"""Interface of degradations that act on images, frame by frame."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Generic, Protocol, TypeVar

import numpy as np

from dslab.scenarios.segments import ImageSegment
from dslab.sim.degradations.base import Stage
from dslab.sim.motion.base import Motion
from dslab.sim.sensors.camera import Intrinsics

Streams = Callable[..., np.random.Generator]
"""Gives the random stream of one segment for a consumer's names."""

USUAL_EXPOSURE_S = 0.01

SegmentT = TypeVar("SegmentT", bound=ImageSegment)


@dataclass(frozen=True)
class View:
    """Data of a frame that a filter may use besides its image.

    Attributes:
        frame: its number before any frame was dropped.
        stamp_s: true centre of its exposure.
        strength: position on the segment's ramp, above 0 to 1; severity grows in proportion.
        depth_m: (H, W) float32 depth along the optical axis, 0 for none; None where unknown.
        motion: the camera's motion; None where unknown.
        exposure_s: shutter time; a usual one where unknown.
    """

    frame: int
    stamp_s: float
    strength: float
    depth_m: np.ndarray | None = None
    motion: Motion | None = None
    exposure_s: float = USUAL_EXPOSURE_S


class Filter(Protocol):
    """One segment, prepared for a camera."""

    def __call__(self, image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
        """Return the degraded frame and its measure, in the unit of the kind.

        Args:
            image: (H, W) uint8, left unchanged; may be returned itself if nothing changes.
            view: further data of the frame.
        """
        ...


class ImageDegradation(ABC, Generic[SegmentT]):
    """One kind of segment that acts on images.

    Attributes:
        kind: as in the scenario.
        stage: one of the later stages.
        measure_name: name of the filter's measure, with its unit.
        needs_depth: frames need a depth image.
        needs_motion: frames need the camera's motion.
        is_drawn: chance has a part in it; False if its filter takes no number from its streams.
    """

    kind: ClassVar[str]
    stage: ClassVar[Stage]
    measure_name: ClassVar[str]
    needs_depth: ClassVar[bool] = False
    needs_motion: ClassVar[bool] = False
    is_drawn: ClassVar[bool] = True

    @abstractmethod
    def sample(self, rng: np.random.Generator) -> dict[str, float | str]:
        """Draw severity parameters from the range between harmless and fatal."""

    @abstractmethod
    def prepare(self, segment: SegmentT, camera: Intrinsics, streams: Streams) -> Filter:
        """Prepare the segment: compute once everything that is the same for all frames."""

    @abstractmethod
    def threshold(self, segment: SegmentT) -> float:
        """The measure from which on the segment counts as acting."""


def ramp(segment: ImageSegment, stamps_s: np.ndarray) -> np.ndarray:
    """(N,) float64 strength of a segment at (N,) times: 0 outside, 1 between its two ramps."""
    inside = (stamps_s >= segment.start_s - 1e-9) & (stamps_s < segment.end_s - 1e-9)
    strength = inside.astype(float)
    for length_s, to_edge_s in (
        (segment.ramp_s, stamps_s - segment.start_s),
        (segment.falls_s, segment.end_s - stamps_s),
    ):
        if length_s > 0:
            strength = np.minimum(strength, np.clip(to_edge_s / length_s, 0, 1))
    return strength
