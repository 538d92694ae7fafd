"""Texture of the surfaces that the camera passes: it fades, or repeats one patch on all of them."""

from dataclasses import replace

import cv2
import numpy as np

from dslab.scenarios.segments import LowTexture, RepeatedTexture, SegmentBase
from dslab.sim.degradations.base import Degradation, FramePlan, Stage, during
from dslab.sim.worlds.base import Surface, WorldModel

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


class RepeatedTextureDegradation(Degradation[RepeatedTexture]):
    """Repeats a patch of the most seen surface on those passed during the segment."""

    kind = "repeated_texture"
    stage = Stage.WORLD
    measure_name = "repeated_share"

    def apply(self, plan: FramePlan, segment: RepeatedTexture) -> FramePlan:
        repeated = _most_seen(plan, segment)
        texture_of, period_m = plan.texture_of.copy(), plan.period_m.copy()
        texture_of[repeated], period_m[repeated] = repeated[:1], segment.period_m
        return replace(plan, texture_of=texture_of, period_m=period_m)

    def measure(self, plan: FramePlan, segment: RepeatedTexture, blur_px: np.ndarray) -> np.ndarray:
        """(N,) share of the view that the changed surfaces fill."""
        return plan.view_share[:, passed(plan, segment) & (plan.period_m > 0)].sum(axis=1, dtype=float)

    def threshold(self, segment: RepeatedTexture) -> float:
        """Half of the view."""
        return HALF_THE_VIEW


def _most_seen(plan: FramePlan, segment: RepeatedTexture) -> np.ndarray:
    """Indices of the passed surfaces, most seen first, that fill the stated share."""
    found = np.flatnonzero(passed(plan, segment))
    seen = plan.view_share[plan.within(segment)][:, found].sum(axis=0, dtype=float)
    order = np.argsort(-seen, kind="stable")
    if not len(found) or segment.share == 0:
        return found[:0]
    reached = np.cumsum(seen[order]) / seen.sum()
    return found[order[: int(np.searchsorted(reached, segment.share - 1e-9)) + 1]]


def with_repeated_texture(world: WorldModel, texture_of: np.ndarray, period_m: np.ndarray) -> WorldModel:
    """The world whose surfaces repeat a square patch in its true size.

    Args:
        world: as built.
        texture_of: (S,) int64 surface that gives the patch, from the middle of its texture.
        period_m: (S,) float64 side of the patch, 0 for an unchanged surface.
    """
    if not period_m.any():
        return world
    surfaces = list(world.surfaces)
    for index in np.flatnonzero(period_m):
        own, source = surfaces[index], world.surfaces[texture_of[index]]
        patch = _patch(source, float(period_m[index]), px_per_m(own))
        rows, columns = (np.arange(pixels) % len(patch) for pixels in own.texture.shape)
        surfaces[index] = replace(own, texture=np.ascontiguousarray(patch[rows][:, columns]))
    return replace(world, surfaces=surfaces)


def px_per_m(surface: Surface) -> float:
    """Pixels of a surface's texture per metre, over all edges of its triangles."""
    ends = surface.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges_px = np.diff(surface.uv[ends], axis=1)[:, 0] * surface.texture.shape[::-1]
    edges_m = np.diff(surface.vertices[ends], axis=1)[:, 0]
    return float(np.linalg.norm(edges_px, axis=1).sum() / np.linalg.norm(edges_m, axis=1).sum())


def _patch(source: Surface, period_m: float, scale: float) -> np.ndarray:
    """(n, n) uint8 patch from the middle of a texture, at ``scale`` pixels per metre."""
    side = max(2, round(period_m * px_per_m(source)))
    height, width = source.texture.shape
    top, left = max(0, (height - side) // 2), max(0, (width - side) // 2)
    patch = source.texture[top : top + side, left : left + side]
    size = max(2, round(period_m * scale))
    return cv2.resize(patch, (size, size), interpolation=cv2.INTER_AREA)
