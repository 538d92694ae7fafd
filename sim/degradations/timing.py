"""Shutter and clock: long exposures, dropped frames, wrong stamps."""

from dataclasses import replace

import numpy as np

from dslab.scenarios.segments import FrameDrops, MotionBlur, TimeJitter
from dslab.sim.degradations.base import Degradation, FramePlan, Stage, streams_of

# A shorter smear leaves corners intact.
FELT_PX = 4.0
# Share of the interval to the neighbouring frame: two such errors cannot swap stamps.
_FARTHEST = 0.49


class MotionBlurDegradation(Degradation[MotionBlur]):
    """Sets the shutter time of the segment's frames; the smear depends on the motion."""

    kind = "motion_blur"
    stage = Stage.SHUTTER
    measure_name = "blur_px"

    def apply(self, plan: FramePlan, segment: MotionBlur) -> FramePlan:
        exposure_s = np.where(plan.within(segment), segment.exposure_s, plan.exposure_s)
        return replace(plan, exposure_s=exposure_s)

    def measure(self, plan: FramePlan, segment: MotionBlur, blur_px: np.ndarray) -> np.ndarray:
        """(N,) median smear of the segment's frames, pixels; 0 elsewhere."""
        return np.where(plan.within(segment), blur_px, 0.0)

    def threshold(self, segment: MotionBlur) -> float:
        """A smear that damages corners."""
        return FELT_PX


class FrameDropsDegradation(Degradation[FrameDrops]):
    """Drops random frames of the segment; a larger share drops a superset.

    The segment's last frame always stays: it shows where the gap ends.
    """

    kind = "frame_drops"
    stage = Stage.TIMING
    measure_name = "frames_missing"

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


class TimeJitterDegradation(Degradation[TimeJitter]):
    """Adds a normal error to each stamp, limited so that stamps keep their order."""

    kind = "time_jitter"
    stage = Stage.TIMING
    measure_name = "stamp_error_s"

    def apply(self, plan: FramePlan, segment: TimeJitter) -> FramePlan:
        # Drawn for every frame before drops: a dropped frame changes no other's error.
        errors = streams_of(plan.seed, segment).standard_normal(int(plan.frame[-1]) + 1)
        gaps_s = np.diff(plan.stamps_s, prepend=-np.inf, append=np.inf)
        room_s = _FARTHEST * np.minimum(gaps_s[:-1], gaps_s[1:])
        error_s = np.clip(segment.sigma_s * errors[plan.frame], -room_s, room_s)
        return replace(plan, stamp_error_s=np.where(plan.within(segment), error_s, plan.stamp_error_s))

    def measure(self, plan: FramePlan, segment: TimeJitter, blur_px: np.ndarray) -> np.ndarray:
        """(N,) absolute stamp error in the segment, seconds."""
        return np.where(plan.within(segment), np.abs(plan.stamp_error_s), 0.0)

    def threshold(self, segment: TimeJitter) -> float:
        """A tenth of the standard deviation."""
        return 0.1 * segment.sigma_s
