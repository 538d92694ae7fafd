"""What a degradation is: parameters in physical units and a pure ``apply`` on what decides the frames.

A scenario's segments act on a ``Shoot``, before a pixel is rendered: on the motion, then on the world's
textures, then on the shutter. Each kind also measures, frame by frame, how much it truly acts, which gives
a segment's true onset and end.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar, Protocol, TypeVar

import numpy as np

from scenarios.spec import Segment
from sim.motion.base import Motion
from sim.sequence import SegmentTruth


class Stage(IntEnum):
    """The order in which degradations act; a later stage sees what the earlier ones made."""

    MOTION = 0
    WORLD = 1
    SHUTTER = 2


@dataclass(frozen=True)
class Shoot:
    """Everything that decides the frames before they are rendered.

    Attributes:
        stamps_s: (N,) float64 centres of the exposures.
        motion: the camera's motion.
        exposure_s: (N,) float64 shutter time of each frame.
        contrast: (S,) float64 texture contrast of each surface of the world.
        view_share: (N, S) float32 share of the view that each surface fills in each frame; (N, 0) where no
            degradation of the world needs it.
    """

    stamps_s: np.ndarray
    motion: Motion
    exposure_s: np.ndarray
    contrast: np.ndarray
    view_share: np.ndarray

    def within(self, segment: Segment) -> np.ndarray:
        """(N,) bool: frames whose stamp lies in the segment, its end excluded."""
        return (self.stamps_s >= segment.start_s - 1e-9) & (self.stamps_s < segment.end_s - 1e-9)


SegmentT_contra = TypeVar("SegmentT_contra", contravariant=True)


class Degradation(Protocol[SegmentT_contra]):
    """One kind of segment.

    Attributes:
        kind: as in the scenario.
        stage: when it acts.
        measure_name: what ``measure`` gives, with its unit.
    """

    kind: ClassVar[str]
    stage: ClassVar[Stage]
    measure_name: ClassVar[str]

    def sample(self, rng: np.random.Generator) -> dict[str, float | str]:
        """Severity parameters drawn from the range over which this kind goes from harmless to fatal."""
        ...

    def apply(self, shoot: Shoot, segment: SegmentT_contra) -> Shoot:
        """The shoot with the segment in it; the given one is left as it was."""
        ...

    def measure(self, shoot: Shoot, segment: SegmentT_contra, blur_px: np.ndarray) -> np.ndarray:
        """(N,) float64: how much the segment acts on each frame.

        Args:
            shoot: with every segment applied.
            segment: the segment to measure.
            blur_px: (N,) median length of each frame's motion blur, pixels.
        """
        ...

    def threshold(self, segment: SegmentT_contra) -> float:
        """The measure from which on the segment is said to act."""
        ...


def true_span(acts: np.ndarray, within: np.ndarray) -> tuple[int, int]:
    """First and last frame of the runs of ``acts`` that touch the segment's own time.

    Args:
        acts: (N,) bool, frames on which the measure reaches its threshold.
        within: (N,) bool, frames of the segment as asked for.

    Returns:
        Frame indices, inclusive; (-1, -1) if no run touches it. A run elsewhere, such as a second visit to
        faded walls, is not the segment's.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], acts, [False]]).astype(np.int8)))
    runs = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if within[a:b].any()]
    return (int(runs[0][0]), int(runs[-1][1] - 1)) if runs else (-1, -1)


def segment_truth(
    degradation: Degradation[Segment], shoot: Shoot, segment: Segment, blur_px: np.ndarray
) -> tuple[SegmentTruth, np.ndarray]:
    """The segment's truth and its (N,) measure per frame."""
    measure = degradation.measure(shoot, segment, blur_px)
    threshold = degradation.threshold(segment)
    first, last = true_span(measure >= threshold, shoot.within(segment))
    truth = SegmentTruth(
        kind=segment.kind,
        severity=segment.severity,
        start_s=segment.start_s,
        end_s=segment.end_s,
        first_frame=first,
        last_frame=last,
        measure=degradation.measure_name,
        threshold=threshold,
    )
    return truth, measure
