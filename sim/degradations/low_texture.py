"""Low texture of the surfaces along the path."""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from scenarios.segments import LowTexture, SegmentBase
from sim.degradations.base import FramePlan, Stage, during

HALF_THE_VIEW = 0.5


class LowTextureDegradation:
    """Lowers the texture contrast of surfaces that the camera passes during the segment.

    A surface is passed when it fills most of the view.
    """

    kind: ClassVar[str] = "low_texture"
    stage: ClassVar[Stage] = Stage.WORLD
    measure_name: ClassVar[str] = "faded_share"

    def sample(self, rng: np.random.Generator) -> dict[str, float | str]:
        """Contrast, uniform in its logarithm: matches fall with log contrast from .5 to .05."""
        return {"contrast": float(np.exp(rng.uniform(np.log(0.02), np.log(0.5))))}

    def apply(self, plan: FramePlan, segment: LowTexture) -> FramePlan:
        """See ``Degradation``."""
        contrast = np.where(passed(plan, segment), plan.contrast * segment.contrast, plan.contrast)
        return replace(plan, contrast=contrast)

    def measure(self, plan: FramePlan, segment: LowTexture, blur_px: np.ndarray) -> np.ndarray:
        """(N,) share of the view that the segment's surfaces fill."""
        if segment.contrast == 1:
            return np.zeros(len(plan.stamps_s))
        return plan.view_share[:, passed(plan, segment)].sum(axis=1, dtype=float)

    def threshold(self, segment: LowTexture) -> float:
        """Half of the view."""
        return HALF_THE_VIEW


def passed(plan: FramePlan, segment: SegmentBase) -> np.ndarray:
    """(S,) bool: surfaces whose moment lies in the segment."""
    return during(segment, plan.moment_s)
