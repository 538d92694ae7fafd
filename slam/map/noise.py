"""The noise of keypoints, as frames tell it."""

from dataclasses import dataclass

import numpy as np

_FRAMES = 100


@dataclass
class KeypointNoise:
    """Variance of the keypoints of a sequence that are found again, over what the view says.

    It is the mean over the frames so far, later over about the last 100.

    Attributes:
        variance: 1 before any frame has told it.
        frames: that have.
    """

    variance: float = 1.0
    frames: int = 0

    def note(self, variance: float) -> None:
        """Learn from a frame; one that has told none, NaN, leaves it as it is."""
        if not np.isfinite(variance):
            return
        self.frames = min(self.frames + 1, _FRAMES)
        self.variance += (variance - self.variance) / self.frames
