"""Segments that act on images, as links of the imaging chain; the truths of all segments."""

from collections.abc import Iterable
from collections.abc import Sequence as Many
from dataclasses import replace
from functools import partial

import numpy as np

from dslab.scenarios.segments import ImageSegment, Segment
from dslab.sim.degradations.base import FramePlan, Stage, segment_truth, streams_of
from dslab.sim.degradations.image import Filter, ramp
from dslab.sim.degradations.registry import FRAME_PLAN_KINDS, IMAGE_KINDS, in_order_of_action
from dslab.sim.link import View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import SegmentTruth


class SegmentLink:
    """One segment: it changes the frames of its time and records its measure.

    It is prepared at its first frame and released after its last.

    Args:
        segment: what acts.
        camera: intrinsics of the images.
        stamps_s: (N,) float64 true times of the frames.
        seed: root seed.

    Attributes:
        segment: the same.
        kind: its degradation.
        strength: (N,) float64 position on its ramp, 0 where it does not act.
        measure: (N,) float64 strength that it had on each frame, in its own unit.
    """

    def __init__(self, segment: ImageSegment, camera: Intrinsics, stamps_s: np.ndarray, seed: int) -> None:
        self.segment, self.kind = segment, IMAGE_KINDS[str(getattr(segment, "kind", ""))]
        self.strength, self.measure = ramp(segment, stamps_s), np.zeros(len(stamps_s))
        self._camera, self._seed = camera, seed
        self._filter: Filter | None = None

    def apply(self, image: np.ndarray, view: View) -> tuple[np.ndarray, View]:
        strength = float(self.strength[view.index])
        if strength == 0:
            return image, view
        if self._filter is None:
            streams = partial(streams_of, self._seed, self.segment)
            self._filter = self.kind.prepare(self.segment, self._camera, streams)
        image, self.measure[view.index] = self._filter(image, replace(view, strength=strength))
        if not self.strength[view.index + 1 :].any():
            self._filter = None
        return image, view

    def truth(self) -> SegmentTruth:
        """Return the segment's truth, after all frames."""
        return segment_truth(self.kind, self.segment, self.measure, self.strength > 0)


def segment_links(
    segments: Iterable[Segment],
    camera: Intrinsics,
    stamps_s: np.ndarray,
    seed: int,
    ideal: Intrinsics | None = None,
) -> list[SegmentLink]:
    """Make links of the segments that act on images, in their order of action.

    Args:
        segments: of a scenario; other kinds are skipped.
        camera: intrinsics of the frames.
        stamps_s: (N,) float64 true times of the frames.
        seed: root seed.
        ideal: intrinsics of the frames before a distorting lens; None without such a lens.
    """
    acting = [segment for segment in in_order_of_action(segments) if isinstance(segment, ImageSegment)]
    before_lens = [IMAGE_KINDS[segment.kind].stage < Stage.LENS for segment in acting]
    return [
        SegmentLink(segment, (ideal or camera) if before else camera, stamps_s, seed)
        for segment, before in zip(acting, before_lens, strict=True)
    ]


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
        if segment in of_images:
            truth, measure = of_images[segment]
        else:
            kind = FRAME_PLAN_KINDS[segment.kind]
            measure = kind.measure(plan, segment, blur_px)
            truth = segment_truth(kind, segment, measure, plan.within(segment))
        truths.append(truth)
        columns[truth.measure] = np.maximum(columns.get(truth.measure, 0.0), measure)
    return truths, columns
