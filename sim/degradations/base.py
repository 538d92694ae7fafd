"""Interface of degradations: physical parameters and a pure ``apply`` on the frame plan.

The first family of kinds acts on a ``FramePlan`` before rendering: on the motion, then on the world's
textures, then on the shutter, then on frame timing. The second family acts on the images
(``sim.degradations.image``). Every kind measures its true strength on each frame, which gives a segment's
true onset and end.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from dslab.scenarios.random_scenarios import random_severity
from dslab.scenarios.seeds import rng_for
from dslab.scenarios.segments import SegmentBase
from dslab.sim.motion.base import Motion


class Stage(IntEnum):
    """Order in which degradations act; a later stage sees the result of earlier ones."""

    MOTION = 0
    WORLD = 1
    SHUTTER = 2
    TIMING = 3
    # On images, along the light path: between surfaces and shutter; with an exposure of its own; the lens.
    SCENE = 4
    READOUT = 5
    LENS = 6
    SENSOR = 7
    ENCODER = 8


def streams_of(seed: int, segment: SegmentBase, *names: str | int) -> np.random.Generator:
    """A random stream of one segment.

    Kind and start identify a segment, so that adding one changes no other's numbers.
    """
    kind = str(getattr(segment, "kind", ""))
    return rng_for(seed, "degradation", kind, round(segment.start_s * 1e6), *names)


@dataclass(frozen=True)
class FramePlan:
    """Everything that decides the frames before they are rendered.

    Attributes:
        stamps_s: (N,) float64 true centres of the exposures.
        motion: the camera's motion.
        exposure_s: (N,) float64 shutter time of each frame.
        contrast: (S,) float64 texture contrast of each surface of the world.
        view_share: (N, S) float32 share of the view that each surface fills in each frame; (N, 0) where no
            degradation of the world needs it.
        seed: root seed of the segments' random draws.
        frame: (N,) int64 number of each frame before any was dropped; empty for 0, 1, 2 ...
        stamp_error_s: (N,) float64 written minus true stamp; empty for no errors.
        texture_of: (S,) int64 surface whose texture patch each surface repeats; empty for none.
        period_m: (S,) float64 side of that patch, 0 where a surface shows its own whole texture.
        moment_s: (S,) float64 true time at which each surface fills most of the view, NaN if never seen;
            empty where ``view_share`` is. Dropped frames do not change it.
    """

    stamps_s: np.ndarray
    motion: Motion
    exposure_s: np.ndarray
    contrast: np.ndarray
    view_share: np.ndarray
    seed: int = 0
    frame: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    stamp_error_s: np.ndarray = field(default_factory=lambda: np.empty(0))
    texture_of: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    period_m: np.ndarray = field(default_factory=lambda: np.empty(0))
    moment_s: np.ndarray = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        count, surfaces = len(self.stamps_s), len(self.contrast)
        for name, default in (
            ("frame", np.arange(count)),
            ("stamp_error_s", np.zeros(count)),
            ("texture_of", np.arange(surfaces)),
            ("period_m", np.zeros(surfaces)),
        ):
            if not len(getattr(self, name)):
                object.__setattr__(self, name, default)
        if self.view_share.size and not len(self.moment_s):
            moment_s = self.stamps_s[self.view_share.argmax(axis=0)]
            seen = self.view_share.max(axis=0) > 0
            object.__setattr__(self, "moment_s", np.where(seen, moment_s, np.nan))

    def first(self, time_s: float) -> "FramePlan":
        """The plan of the frames whose written stamps lie less than ``time_s`` after the first one's."""
        written_s = self.stamps_s + self.stamp_error_s
        return self.only(written_s - written_s[0] < time_s)

    def only(self, kept: np.ndarray) -> "FramePlan":
        """The plan reduced to the frames ``kept``, (N,) bool."""
        names = ("stamps_s", "exposure_s", "view_share", "frame", "stamp_error_s")
        return replace(self, **{name: getattr(self, name)[kept] for name in names})

    def within(self, segment: SegmentBase) -> np.ndarray:
        """(N,) bool: frames whose stamp lies in the segment, its end excluded."""
        return during(segment, self.stamps_s)


def during(segment: SegmentBase, stamps_s: np.ndarray) -> np.ndarray:
    """(N,) bool: times in the segment, its end excluded."""
    return (stamps_s >= segment.start_s - 1e-9) & (stamps_s < segment.end_s - 1e-9)


SegmentT = TypeVar("SegmentT", bound=SegmentBase)


class Kind(ABC, Generic[SegmentT]):
    """One kind of segment.

    Attributes:
        kind: as in the scenario.
        stage: its place in the order.
        measure_name: name of the measure, with its unit.
    """

    kind: ClassVar[str]
    stage: ClassVar[Stage]
    measure_name: ClassVar[str]

    def sample(self, rng: np.random.Generator, /) -> dict[str, Any]:
        """Draw severity parameters from harmless to fatal; here as ``scenarios`` does for the lab's own."""
        return random_severity(self.kind, rng)

    @abstractmethod
    def threshold(self, segment: SegmentT) -> float:
        """The measure from which on the segment counts as acting."""


class Degradation(Kind[SegmentT]):
    """A kind that changes the frame plan; see ``Kind``."""

    @abstractmethod
    def apply(self, plan: FramePlan, segment: SegmentT) -> FramePlan:
        """Return the plan with the segment applied; the given plan is left unchanged."""

    @abstractmethod
    def measure(self, plan: FramePlan, segment: SegmentT, blur_px: np.ndarray) -> np.ndarray:
        """(N,) float64 strength of the segment on each frame.

        Args:
            plan: with every segment applied.
            segment: the segment to measure.
            blur_px: (N,) median length of each frame's motion blur, pixels.
        """
