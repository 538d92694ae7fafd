"""The buffer of ORB features over which a recovery runs backward. Source: paper, Sec. III-A and Fig. 4."""

from collections import deque
from collections.abc import Iterator

from slam.frame import FrameFeatures


class FeatureBuffer:
    """Features of the most recent frames: a ring in normal operation, growing while frozen.

    Args:
        span_s: k of the paper, as time: what the ring holds.
        cap_s: the most it grows to while frozen; beyond it the oldest frames go, as in the ring.
    """

    def __init__(self, span_s: float, cap_s: float) -> None:
        if not 0 < span_s <= cap_s:
            raise ValueError(f"need 0 < span_s <= cap_s, got {span_s} and {cap_s}")
        self.span_s = span_s
        self.cap_s = cap_s
        self.frozen = False
        self._frames: deque[FrameFeatures] = deque()

    def __len__(self) -> int:
        return len(self._frames)

    def append(self, features: FrameFeatures) -> None:
        """Take the newest frame; frames older than the span (frozen: the cap) leave."""
        self._frames.append(features)
        limit = self.cap_s if self.frozen else self.span_s
        while features.stamp_s - self._frames[0].stamp_s > limit:
            self._frames.popleft()

    def backward_from(self, index: int) -> Iterator[FrameFeatures]:
        """Frames before frame ``index``, newest first."""
        return (f for f in reversed(self._frames) if f.index < index)

    def reaches(self, index: int) -> bool:
        """Whether frame ``index`` or an older one is still held."""
        return bool(self._frames) and self._frames[0].index <= index

    @property
    def nbytes(self) -> int:
        """Memory of the buffered features."""
        return sum(f.nbytes for f in self._frames)
