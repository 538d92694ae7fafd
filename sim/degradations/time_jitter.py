"""Time jitter: wrong stamps."""

from dataclasses import replace

import numpy as np

from dslab.scenarios.segments import TimeJitter
from dslab.sim.degradations.base import Degradation, FramePlan, Stage, drawn, log_uniform, streams_of

FELT_SHARE = 0.1
# Share of the interval to the neighbouring frame: two such errors cannot swap stamps.
_FARTHEST = 0.49


class TimeJitterDegradation(Degradation[TimeJitter]):
    """Adds a normal error to each stamp, limited so that stamps keep their order."""

    kind = "time_jitter"
    stage = Stage.TIMING
    measure_name = "stamp_error_s"
    sample = drawn(sigma_s=log_uniform(0.001, 0.03))

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
        return FELT_SHARE * segment.sigma_s
