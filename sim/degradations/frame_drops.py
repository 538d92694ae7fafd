"""Dropped frames."""

from typing import ClassVar

import numpy as np

from dslab.scenarios.segments import FrameDrops
from dslab.sim.degradations.base import FramePlan, Stage, streams_of


class FrameDropsDegradation:
    """Drops random frames of the segment; a larger share drops a superset.

    The segment's last frame always stays: it shows where the gap ends.
    """

    kind: ClassVar[str] = "frame_drops"
    stage: ClassVar[Stage] = Stage.TIMING
    measure_name: ClassVar[str] = "frames_missing"

    def sample(self, rng: np.random.Generator) -> dict[str, float | str]:
        """Share, uniform."""
        return {"share": float(rng.uniform(0.2, 1))}

    def apply(self, plan: FramePlan, segment: FrameDrops) -> FramePlan:
        """See ``Degradation``."""
        inside = np.flatnonzero(plan.within(segment))[:-1]
        order = streams_of(plan.seed, segment).permutation(len(inside))
        kept = np.ones(len(plan.stamps_s), bool)
        kept[inside[order[: round(segment.share * len(inside))]]] = False
        return plan.only(kept)

    def measure(self, plan: FramePlan, segment: FrameDrops, blur_px: np.ndarray) -> np.ndarray:
        """(N,) number of frames missing just before each frame of the segment."""
        missing = np.diff(plan.frame, prepend=-1) - 1
        return np.where(plan.within(segment), missing, 0).astype(float)

    def threshold(self, segment: FrameDrops) -> float:
        """One frame."""
        return 1.0
