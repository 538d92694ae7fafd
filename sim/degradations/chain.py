"""The image-space segments of a sequence, applied to its frames along the light path."""

from collections.abc import Mapping
from collections.abc import Sequence as Many
from functools import partial

import numpy as np

from dslab.scenarios.segments import ImageSegment, Segment
from dslab.sim.degradations.base import Stage, streams_of, truth_of
from dslab.sim.degradations.image import USUAL_EXPOSURE_S, View, ramp
from dslab.sim.degradations.registry import IMAGE_KINDS, in_order_of_action
from dslab.sim.motion.base import Motion
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import SegmentTruth


class ImageChain:
    """Applies image-space segments frame by frame and records their measures.

    Segments are prepared at their first frame and released after their last.

    Args:
        segments: of a scenario; other kinds are skipped.
        camera: intrinsics of the frames.
        stamps_s: (N,) float64 true times of the frames.
        frame: (N,) int64 number of each frame before any was dropped.
        seed: root seed.
        exposure_s: (N,) float64 shutter times; None where unknown.
        ideal: intrinsics of the frames before a distorting lens, used between surfaces and lens; None
            without such a lens.
        measured: (N,) measure of every segment that has acted on the frames already.
    """

    def __init__(
        self,
        segments: Many[Segment],
        camera: Intrinsics,
        stamps_s: np.ndarray,
        frame: np.ndarray,
        seed: int,
        exposure_s: np.ndarray | None = None,
        ideal: Intrinsics | None = None,
        measured: Mapping[Segment, np.ndarray] | None = None,
    ) -> None:
        self._camera, self._ideal = camera, ideal or camera
        self._stamps_s, self._frame, self._seed = stamps_s, frame, seed
        self._exposure_s = np.full(len(stamps_s), USUAL_EXPOSURE_S) if exposure_s is None else exposure_s
        self._links = [
            _Link(segment, ramp(segment, stamps_s))
            for segment in in_order_of_action(segments)
            if isinstance(segment, ImageSegment)
        ]
        for link in self._links:
            if measured and link.segment in measured:
                link.measure, link.has_acted = measured[link.segment], True

    def acts(self, index: int, stages: Many[Stage]) -> bool:
        """True if a segment of these stages acts on a frame."""
        return any(link.kind.stage in stages and link.strength[index] != 0 for link in self._links)

    def apply(
        self,
        image: np.ndarray,
        index: int,
        stages: Many[Stage],
        depth_m: np.ndarray | None = None,
        motion: Motion | None = None,
    ) -> np.ndarray:
        """Return the (H, W) uint8 image after the given stages; the given image is unchanged.

        Args:
            image: frame ``index`` of the sequence.
            index: index of the frame in ``stamps_s``.
            stages: stages to apply.
            depth_m: (H, W) float32, for kinds that need it.
            motion: for kinds that need it.
        """
        for link in self._links:
            if link.has_acted or link.kind.stage not in stages or link.strength[index] == 0:
                continue
            view = View(
                int(self._frame[index]),
                float(self._stamps_s[index]),
                float(link.strength[index]),
                depth_m,
                motion,
                float(self._exposure_s[index]),
            )
            camera = self._ideal if link.kind.stage < Stage.LENS else self._camera
            image, link.measure[index] = link.filter(camera, self._seed)(image, view)
            if not link.strength[index + 1 :].any():
                link.release()
        return image

    def truths(self) -> dict[Segment, tuple[SegmentTruth, np.ndarray]]:
        """Truth and (N,) measure of every image-space segment, after all frames."""
        found = {}
        for link in self._links:
            threshold, name = link.kind.threshold(link.segment), link.kind.measure_name
            truth = truth_of(link.segment, name, link.measure, threshold, link.strength > 0)
            found[link.segment] = (truth, link.measure)
        return found


class _Link:
    """One segment, its strength and its measure per frame."""

    def __init__(self, segment: Segment, strength: np.ndarray) -> None:
        self.segment, self.kind, self.strength = segment, IMAGE_KINDS[segment.kind], strength
        self.measure = np.zeros(len(strength))
        self.has_acted = False
        self._filter = None

    def filter(self, camera: Intrinsics, seed: int):
        if self._filter is None:
            self._filter = self.kind.prepare(self.segment, camera, partial(streams_of, seed, self.segment))
        return self._filter

    def release(self) -> None:
        """Release sprites, masks and noise."""
        self._filter = None
