"""Defocus: every point is a disc of light."""

from functools import lru_cache

import cv2
import numpy as np

from dslab.scenarios.segments import Defocus
from dslab.sim.degradations.base import Stage, drawn, log_uniform
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import decode, encode

# A pixel averages over such a disc anyway.
SHARP_PX = 1.0
FELT_PX = 4.0
_SUBPIXELS = 8


class DefocusDegradation(ImageDegradation[Defocus]):
    """Spreads the light evenly over a disc."""

    kind = "defocus"
    stage = Stage.LENS
    measure_name = "defocus_px"
    sample = drawn(diameter_px=log_uniform(2, 40))

    def prepare(self, segment: Defocus, camera: Intrinsics, streams: Streams) -> Filter:
        def defocus(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            diameter_px = view.strength * segment.diameter_px
            if diameter_px <= SHARP_PX:
                return image, diameter_px
            return encode(cv2.filter2D(decode(image), -1, disc(diameter_px))), diameter_px

        return defocus

    def threshold(self, segment: Defocus) -> float:
        """A disc that damages corners, or the segment's own if smaller."""
        return min(FELT_PX, segment.diameter_px)


@lru_cache(maxsize=8)
def disc(diameter_px: float) -> np.ndarray:
    """(k, k) float32 share of the disc's light on each pixel, sum 1, k odd."""
    reach = int(np.ceil(diameter_px / 2 - 0.5))
    size = 2 * reach + 1
    at = (np.arange(size * _SUBPIXELS) + 0.5) / _SUBPIXELS - size / 2
    inside = (at[:, None] ** 2 + at**2 <= (diameter_px / 2) ** 2).astype(np.float32)
    kernel = inside.reshape(size, _SUBPIXELS, size, _SUBPIXELS).mean(axis=(1, 3))
    return kernel / kernel.sum()
