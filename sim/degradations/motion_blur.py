"""Motion blur: the shutter stays open longer."""

from dataclasses import replace

import numpy as np

from dslab.scenarios.spec import MotionBlur
from dslab.sim.degradations.base import Degradation, FramePlan, Stage, drawn, log_uniform

# A shorter smear leaves corners intact.
FELT_PX = 4.0


class MotionBlurDegradation(Degradation[MotionBlur]):
    """Sets the shutter time of the segment's frames; the smear depends on the motion."""

    kind = "motion_blur"
    stage = Stage.SHUTTER
    measure_name = "blur_px"
    sample = drawn(exposure_s=log_uniform(0.01, 0.3))

    def apply(self, plan: FramePlan, segment: MotionBlur) -> FramePlan:
        exposure_s = np.where(plan.within(segment), segment.exposure_s, plan.exposure_s)
        return replace(plan, exposure_s=exposure_s)

    def measure(self, plan: FramePlan, segment: MotionBlur, blur_px: np.ndarray) -> np.ndarray:
        """(N,) median smear of the segment's frames, pixels; 0 elsewhere."""
        return np.where(plan.within(segment), blur_px, 0.0)

    def threshold(self, segment: MotionBlur) -> float:
        """A smear that damages corners."""
        return FELT_PX
