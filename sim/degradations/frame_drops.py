"""Dropped frames."""

import numpy as np

from dslab.scenarios.segments import FrameDrops
from dslab.sim.degradations.base import Degradation, FramePlan, Stage, drawn, streams_of, uniform


class FrameDropsDegradation(Degradation[FrameDrops]):
    """Drops random frames of the segment; a larger share drops a superset.

    The segment's last frame always stays: it shows where the gap ends.
    """

    kind = "frame_drops"
    stage = Stage.TIMING
    measure_name = "frames_missing"
    sample = drawn(share=uniform(0.2, 1))

    def apply(self, plan: FramePlan, segment: FrameDrops) -> FramePlan:
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
