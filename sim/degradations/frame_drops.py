"""Dropped frames."""

from typing import ClassVar

import numpy as np

from scenarios.segments import FrameDrops
from sim.degradations.base import Shoot, Stage, streams_of


class FrameDropsDegradation:
    """Takes frames out of the segment, at random; a larger share drops those of a smaller one and more.

    The segment's last frame always stays: it shows where the gap ends.
    """

    kind: ClassVar[str] = "frame_drops"
    stage: ClassVar[Stage] = Stage.TIMING
    measure_name: ClassVar[str] = "frames_missing"

    def sample(self, rng: np.random.Generator) -> dict[str, float | str]:
        """Share, uniform."""
        return {"share": float(rng.uniform(0.2, 1))}

    def apply(self, shoot: Shoot, segment: FrameDrops) -> Shoot:
        """See ``Degradation``."""
        inside = np.flatnonzero(shoot.within(segment))[:-1]
        order = streams_of(shoot.seed, segment).permutation(len(inside))
        kept = np.ones(len(shoot.stamps_s), bool)
        kept[inside[order[: round(segment.share * len(inside))]]] = False
        return shoot.only(kept)

    def measure(self, shoot: Shoot, segment: FrameDrops, blur_px: np.ndarray) -> np.ndarray:
        """(N,) frames that are missing just before each frame of the segment."""
        missing = np.diff(shoot.frame, prepend=-1) - 1
        return np.where(shoot.within(segment), missing, 0).astype(float)

    def threshold(self, segment: FrameDrops) -> float:
        """One frame."""
        return 1.0
