"""Segments that act on images, as links of the imaging chain."""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from dslab.scenarios.segments import ImageSegment, Segment
from dslab.sim.degradations.base import Stage, during, streams_of
from dslab.sim.degradations.image import Filter
from dslab.sim.degradations.registry import IMAGE_KINDS, in_order_of_action
from dslab.sim.link import View
from dslab.sim.sensors.camera import Intrinsics


class SegmentLink:
    """One segment on frames at (N,) true times: it changes those of its time and records its measure.

    It is prepared at its first frame and released after its last.

    Attributes:
        segment: what acts.
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
        acting = replace(view, strength=strength)
        if image.ndim == 2 or self.kind.takes_colour:
            image, self.measure[view.index] = self._filter(image, acting)
        else:
            image, self.measure[view.index] = _by_channel(self._filter, image, acting)
        if not self.strength[view.index + 1 :].any():
            self._filter = None
        return image, view


def segment_links(
    segments: Iterable[Segment],
    camera: Intrinsics,
    stamps_s: np.ndarray,
    seed: int,
    ideal: Intrinsics | None = None,
) -> list[SegmentLink]:
    """Make links of the segments that act on images, in their order of action; others are skipped.

    Arguments as of ``SegmentLink``; ``ideal`` are the intrinsics before a distorting lens, None without one.
    """
    acting = [segment for segment in in_order_of_action(segments) if isinstance(segment, ImageSegment)]
    before_lens = [IMAGE_KINDS[segment.kind].stage < Stage.LENS for segment in acting]
    return [
        SegmentLink(segment, (ideal or camera) if before else camera, stamps_s, seed)
        for segment, before in zip(acting, before_lens, strict=True)
    ]


def _by_channel(act: Filter, image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
    """A frame (H, W, 3) whose channels are images of one light each, and the largest measure."""
    done = [act(np.ascontiguousarray(image[..., at]), replace(view, channel=at)) for at in range(3)]
    return np.dstack([shown for shown, _ in done]), max(measure for _, measure in done)


def ramp(segment: ImageSegment, stamps_s: np.ndarray) -> np.ndarray:
    """(N,) float64 strength of a segment at (N,) times: 0 outside, 1 between its two ramps."""
    strength = during(segment, stamps_s).astype(float)
    for length_s, to_edge_s in (
        (segment.ramp_s, stamps_s - segment.start_s),
        (segment.falls_s, segment.end_s - stamps_s),
    ):
        if length_s > 0:
            strength = np.minimum(strength, np.clip(to_edge_s / length_s, 0, 1))
    return strength
