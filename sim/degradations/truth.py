"""When segments truly act, by what they measured on each frame."""

from collections.abc import Iterable

import numpy as np

from dslab.scenarios.segments import Segment
from dslab.sim.degradations.base import FramePlan
from dslab.sim.degradations.registry import FRAME_PLAN_KINDS, in_order_of_action
from dslab.sim.degradations.segment_link import SegmentLink
from dslab.sim.sequence import SegmentTruth


def truths_of(
    segments: Iterable[Segment], plan: FramePlan, links: Iterable[SegmentLink], blur_px: np.ndarray
) -> tuple[list[SegmentTruth], dict[str, np.ndarray]]:
    """Truths by start, then by order of action, and the columns of their measures.

    A measure of 0 never counts as acting. Segments with the same measure share a column, which holds the
    larger value; segments of one kind do not overlap.

    Args:
        segments: all of the sequence.
        plan: with every segment applied.
        links: the segments that act on images, after all frames.
        blur_px: (N,) median length of each frame's motion blur, pixels.
    """
    on_images = {link.segment: link for link in links}
    truths: list[SegmentTruth] = []
    columns: dict[str, np.ndarray] = {}
    for segment in sorted(in_order_of_action(segments), key=lambda segment: segment.start_s):
        if link := on_images.get(segment):
            kind, measure, within = link.kind, link.measure, link.strength > 0
        else:
            kind = FRAME_PLAN_KINDS[segment.kind]
            measure, within = kind.measure(plan, segment, blur_px), plan.within(segment)
        threshold = kind.threshold(segment)
        runs = true_runs((measure >= threshold) & (measure > 0), within)
        truth = SegmentTruth(
            kind=segment.kind,
            severity=segment.severity,
            start_s=segment.start_s,
            end_s=segment.end_s,
            first_frame=runs[0][0] if runs else -1,
            last_frame=runs[-1][1] if runs else -1,
            measure=kind.measure_name,
            threshold=threshold,
            runs=runs,
        )
        truths.append(truth)
        columns[truth.measure] = np.maximum(columns.get(truth.measure, 0.0), measure)
    return truths, columns


def true_runs(acts: np.ndarray, within: np.ndarray) -> tuple[tuple[int, int], ...]:
    """The runs of ``acts`` that touch the segment's own time.

    Args:
        acts: (N,) bool, frames on which the measure reaches its threshold.
        within: (N,) bool, frames in the segment's declared time.

    Returns:
        First and last frame of each, inclusive, in order. A run elsewhere, such as a second visit to faded
        walls, is not the segment's.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], acts, [False]]).astype(np.int8)))
    runs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return tuple((first, end - 1) for first, end in runs if within[first:end].any())
