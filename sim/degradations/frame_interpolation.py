"""Light at any time between recorded frames, along the optical flow from one to the next."""

from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np


class FrameInterpolation:
    """Frames at times between those recorded.

    Of a moment's two neighbours, each is warped along the flow to that moment, and the two are mixed by their
    nearness. The flow from the moment to a neighbour follows from the flows of both directions at the same
    pixel, as if it were smooth there: at the outlines of near things, and where a point moves further than
    the flow can follow, both neighbours show faintly.

    Source: Jiang et al., "Super SloMo", CVPR 2018, eq. 4 (the mixture); Kroeger et al., "Fast optical flow
    using dense inverse search", ECCV 2016.

    Args:
        gray: the (H, W) uint8 frame of a number, from which the flow is found.
        light: its (H, W) float32 light, or (H, W, 3).
        stamps_s: (N,) float64 times of the frames.
        kept: flows that are remembered.
    """

    def __init__(
        self,
        gray: Callable[[int], np.ndarray],
        light: Callable[[int], np.ndarray],
        stamps_s: np.ndarray,
        kept: int,
    ) -> None:
        self._gray, self._stamps_s = gray, stamps_s
        self._light = lru_cache(kept + 1)(light)
        self.flows = lru_cache(kept)(self._flows)

    def at(self, time_s: float) -> np.ndarray:
        """(H, W) float32 light at a time from the first frame's to the last one's."""
        first, share = self.place(time_s)
        if share == 0:
            return self._light(first)
        forth, back = self.flows(first)
        mixed = (1 - share) * _warped(self._light(first), share * share * back - (1 - share) * share * forth)
        mixed += share * _warped(
            self._light(first + 1), (1 - share) ** 2 * forth - share * (1 - share) * back
        )
        return mixed

    def place(self, time_s: float) -> tuple[int, float]:
        """The frame before a time, and the share of the interval to the next one that has passed."""
        last = len(self._stamps_s) - 1
        first = int(np.clip(np.searchsorted(self._stamps_s, time_s, "right") - 1, 0, max(last - 1, 0)))
        if first == last:
            return first, 0.0
        interval_s = self._stamps_s[first + 1] - self._stamps_s[first]
        return first, float(np.clip((time_s - self._stamps_s[first]) / interval_s, 0, 1))

    def shift_px(self, from_s: float, to_s: float) -> np.ndarray:
        """(H, W, 2) float32 pixels by which the image moves between two times."""
        (first, begun), (last, passed) = self.place(from_s), self.place(to_s)
        shift = np.zeros((*self._gray(first).shape, 2), np.float32)
        for frame in range(first, last + 1):
            share = (passed if frame == last else 1.0) - (begun if frame == first else 0.0)
            if share > 0:
                shift += share * self.flows(frame)[0]
        return shift

    def _flows(self, first: int) -> tuple[np.ndarray, np.ndarray]:
        """(H, W, 2) float32 flow from a frame to the next one, and back."""
        one, other = self._gray(first), self._gray(first + 1)
        threads = cv2.getNumThreads()
        # The flow depends on the number of threads: one gives the same bits everywhere.
        cv2.setNumThreads(1)
        try:
            return _flow(one, other), _flow(other, one)
        finally:
            cv2.setNumThreads(threads)


def _flow(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    if np.array_equal(one, other):
        return np.zeros((*one.shape, 2), np.float32)
    return cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(one, other, None)


def _warped(light: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """(H, W) float32 light, each pixel taken from beside it; beyond the borders from the border."""
    height, width = light.shape[:2]
    x = shift[..., 0] + np.arange(width, dtype=np.float32)
    y = shift[..., 1] + np.arange(height, dtype=np.float32)[:, None]
    return cv2.remap(light, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
