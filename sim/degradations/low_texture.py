"""Low texture of the surfaces along the path."""

from dataclasses import replace

import numpy as np

from dslab.scenarios.segments import LowTexture, SegmentBase
from dslab.sim.degradations.base import Degradation, FramePlan, Stage, drawn, during, log_uniform

HALF_THE_VIEW = 0.5
_NEVER, _ROUNDING = 1e-12, 1e-9


class LowTextureDegradation(Degradation[LowTexture]):
    """Lowers the texture contrast of surfaces that the camera passes during the segment.

    A surface is passed when it fills most of the view. With ``view_share`` surfaces fade until they fill that
    share of the view, on average over the segment.
    """

    kind = "low_texture"
    stage = Stage.WORLD
    measure_name = "faded_share"
    # Matches fall with log contrast from .5 to .05.
    sample = drawn(contrast=log_uniform(0.02, 0.5))

    def apply(self, plan: FramePlan, segment: LowTexture) -> FramePlan:
        contrast = np.where(_faded(plan, segment), plan.contrast * segment.contrast, plan.contrast)
        return replace(plan, contrast=contrast)

    def measure(self, plan: FramePlan, segment: LowTexture, blur_px: np.ndarray) -> np.ndarray:
        """(N,) share of the view that the segment's surfaces fill."""
        if segment.contrast == 1:
            return np.zeros(len(plan.stamps_s))
        return plan.view_share[:, _faded(plan, segment)].sum(axis=1, dtype=float)

    def threshold(self, segment: LowTexture) -> float:
        """Half of the view, or the share asked for if that is less."""
        return HALF_THE_VIEW if segment.view_share is None else min(HALF_THE_VIEW, segment.view_share)


def passed(plan: FramePlan, segment: SegmentBase) -> np.ndarray:
    """(S,) bool: surfaces whose moment lies in the segment."""
    return during(segment, plan.moment_s)


def _faded(plan: FramePlan, segment: LowTexture) -> np.ndarray:
    """(S,) bool: surfaces passed, or those that fill the share of the view and are least seen outside."""
    if segment.view_share is None:
        return passed(plan, segment)
    within = plan.within(segment)
    inside = (
        plan.view_share[within].mean(axis=0, dtype=float) if within.any() else np.zeros(len(plan.contrast))
    )
    everywhere = plan.view_share.sum(axis=0, dtype=float)
    # By the view that they fill outside, for each unit of view inside.
    order = np.argsort(-inside / np.maximum(everywhere, _NEVER), kind="stable")
    filled = np.cumsum(inside[order])
    faded = np.zeros(len(inside), bool)
    faded[order[: int(np.searchsorted(filled, segment.view_share - _ROUNDING)) + 1]] = True
    return faded & (inside > 0)
