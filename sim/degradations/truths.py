"""The truths of a sequence's segments, in an order independent of their declaration."""

from collections.abc import Iterable
from collections.abc import Sequence as Many

import numpy as np

from dslab.scenarios.segments import Segment
from dslab.sim.degradations.base import FramePlan, segment_truth
from dslab.sim.degradations.registry import FRAME_PLAN_KINDS, in_order_of_action
from dslab.sim.degradations.segment_link import SegmentLink
from dslab.sim.sequence import SegmentTruth


def truths_of(
    segments: Many[Segment], plan: FramePlan, links: Iterable[SegmentLink], blur_px: np.ndarray
) -> tuple[list[SegmentTruth], dict[str, np.ndarray]]:
    """Truths by start, then by order of action, and the columns of their measures.

    Segments with the same measure share a column, which holds the larger value; segments of one kind do not
    overlap. The runs of each truth give the frames on which it acts.

    Args:
        segments: all of the sequence.
        plan: with every segment applied.
        links: the segments that act on images, after all frames.
        blur_px: (N,) median length of each frame's motion blur, pixels.
    """
    of_images = {link.segment: (link.truth(), link.measure) for link in links}
    truths: list[SegmentTruth] = []
    columns: dict[str, np.ndarray] = {}
    for segment in sorted(in_order_of_action(segments), key=lambda segment: segment.start_s):
        truth, measure = of_images.get(segment) or segment_truth(
            FRAME_PLAN_KINDS[segment.kind], plan, segment, blur_px
        )
        truths.append(truth)
        columns[truth.measure] = np.maximum(columns.get(truth.measure, 0.0), measure)
    return truths, columns
