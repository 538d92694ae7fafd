"""Does the stress of a scenario act, by its own measure? From the plan and as few frames as tell."""

from collections.abc import Iterator

import numpy as np

from dslab.scenarios.segments import ImageSegment, Segment
from dslab.scenarios.spec import Scenario
from dslab.sim.degradations.base import FramePlan, Stage, during
from dslab.sim.degradations.registry import DEGRADATIONS, FRAME_PLAN_KINDS
from dslab.sim.degradations.segment_link import ramp
from dslab.sim.degradations.truth import truths_of
from dslab.sim.frame_plan import RenderBackend, plan_in_world, render_backend
from dslab.sim.preview import Preview, preview
from dslab.sim.sequence import SegmentTruth

_WITHOUT_A_WORLD = {Stage.MOTION, Stage.TIMING}
_AT_ONCE = 4
"""Frames that are rendered together; the middle of a segment is tried first."""


def stress_acts(scenario: Scenario, backend: RenderBackend | None = None) -> bool:
    """True if a segment reaches its kind's threshold on a frame of its own time.

    It is what ``first_frame`` of the sequence's truth says, without rendering the sequence: a motion or a
    world is measured on the plan, a shutter or an image on frames of the segment until one tells.

    Args:
        scenario: with its own seed.
        backend: worlds and renderer; None for MuJoCo.

    Raises:
        InputError: as ``sim.preview.preview``.
    """
    backend = backend or render_backend()
    stages = {DEGRADATIONS[segment.kind].stage for segment in scenario.segments}
    if stages <= _WITHOUT_A_WORLD:
        plan = plan_in_world(scenario, backend)
        return any(_acts_on_plan(plan, segment) for segment in scenario.segments)
    looked = preview(scenario, backend)
    return any(
        _acts_on_plan(looked.plan, segment)
        if DEGRADATIONS[segment.kind].stage in (*_WITHOUT_A_WORLD, Stage.WORLD)
        else any(_acts_on(looked, segment, frames) for frames in _from_the_middle(looked.plan, segment))
        for segment in scenario.segments
    )


def stress_measure(scenario: Scenario, backend: RenderBackend | None = None) -> tuple[str, float]:
    """What the first segment of a scenario measures, by its kind's own measure, on a few frames of its time.

    Args:
        scenario: with its own seed and at least one segment.
        backend: worlds and renderer; None for MuJoCo.

    Returns:
        Name of the measure, with its unit, and its median over the segment's middle frames.

    Raises:
        InputError: as ``sim.preview.preview``.
    """
    backend, segment = backend or render_backend(), scenario.segments[0]
    if DEGRADATIONS[segment.kind].stage in _WITHOUT_A_WORLD:
        plan = plan_in_world(scenario, backend)
        kind = FRAME_PLAN_KINDS[segment.kind]
        measure = kind.measure(plan, segment, np.zeros(len(plan.stamps_s)))[plan.within(segment)]
        return kind.measure_name, float(np.median(measure)) if len(measure) else 0.0
    looked = preview(scenario, backend)
    frames = next(_from_the_middle(looked.plan, segment))
    truths, columns = _truths_on(looked, segment, frames)
    return truths[0].measure, float(np.median(columns[truths[0].measure]))


def _acts_on_plan(plan: FramePlan, segment: Segment) -> bool:
    kind = FRAME_PLAN_KINDS[segment.kind]
    measure = kind.measure(plan, segment, np.zeros(len(plan.stamps_s)))
    return bool(((measure >= kind.threshold(segment)) & (measure > 0) & plan.within(segment)).any())


def _acts_on(looked: Preview, segment: Segment, frames: np.ndarray) -> bool:
    """True if the segment acts on one of these frames, (K,) increasing indices."""
    return _truths_on(looked, segment, frames)[0][0].first_frame >= 0


def _truths_on(
    looked: Preview, segment: Segment, frames: np.ndarray
) -> tuple[list[SegmentTruth], dict[str, np.ndarray]]:
    _, blur_px, links = looked.expose_frames(frames.tolist())
    part = looked.plan.only(np.isin(np.arange(len(looked.plan.stamps_s)), frames))
    return truths_of((segment,), part, links, blur_px)


def _from_the_middle(plan: FramePlan, segment: Segment) -> Iterator[np.ndarray]:
    """Indices of the segment's frames in small parts, from the strongest and the middle outwards."""
    own = np.flatnonzero(during(segment, plan.stamps_s))
    strength = ramp(segment, plan.stamps_s[own]) if isinstance(segment, ImageSegment) else np.ones(len(own))
    order = own[np.lexsort((np.abs(own - own.mean()), -strength))] if len(own) else own
    for start in range(0, len(order), _AT_ONCE):
        yield np.sort(order[start : start + _AT_ONCE])
