"""Focus: points that are discs of light, all alike or by their depth."""

from functools import lru_cache

import cv2
import numpy as np

from dslab.scenarios.segments import Defocus, ShallowFocus
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import decode, encode

# A pixel averages over such a disc anyway.
SHARP_PX = 1.0
_SUBPIXELS = 8
_MOST_PX = 80.0
# Two layers follow one another by this factor in the width of their blur.
_STEP = 1.35
_LEAST_COVER = np.float32(1e-3)


class DefocusDegradation(ImageDegradation[Defocus]):
    """Spreads the light evenly over a disc."""

    kind = "defocus"
    stage = Stage.LENS
    measure_name = "defocus_px"

    def prepare(self, segment: Defocus, camera: Intrinsics, streams: Streams) -> Filter:
        def defocus(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            diameter_px = view.strength * segment.diameter_px
            if diameter_px <= SHARP_PX:
                return image, diameter_px
            return encode(cv2.filter2D(decode(image), -1, disc(diameter_px))), diameter_px

        return defocus

    def threshold(self, segment: Defocus) -> float:
        """A disc that damages corners, or the segment's own if smaller."""
        return min(4.0, segment.diameter_px)


@lru_cache(maxsize=8)
def disc(diameter_px: float) -> np.ndarray:
    """(k, k) float32 share of the disc's light on each pixel, sum 1, k odd."""
    reach = int(np.ceil(diameter_px / 2 - 0.5))
    size = 2 * reach + 1
    at = (np.arange(size * _SUBPIXELS) + 0.5) / _SUBPIXELS - size / 2
    inside = (at[:, None] ** 2 + at**2 <= (diameter_px / 2) ** 2).astype(np.float32)
    kernel = inside.reshape(size, _SUBPIXELS, size, _SUBPIXELS).mean(axis=(1, 3))
    return kernel / kernel.sum()


class ShallowFocusDegradation(ImageDegradation[ShallowFocus]):
    """Blurs each surface by the circle of confusion of a thin lens.

    A lens of opening ``A`` in focus at ``s`` shows a point at depth ``d`` as a disc of ``f A |1/s - 1/d|``
    pixels, ``f`` the focal length in pixels. Surfaces are blurred in layers of depth and laid over one
    another, the farthest first, so that a sharp thing has a sharp outline before a blurred background.
    """

    kind = "shallow_focus"
    # It needs the depth before a distorting lens.
    stage = Stage.READOUT
    measure_name = "focus_blur_px"
    needs_depth = True
    is_drawn = False

    def prepare(self, segment: ShallowFocus, camera: Intrinsics, streams: Streams) -> Filter:
        def focus(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            if view.depth_m is None:
                raise ValueError("shallow_focus needs depth")
            scale_px = view.strength * segment.aperture_mm / 1000 * camera.fx
            blur_px = signed_blur_px(view.depth_m, scale_px, segment.focus_m)
            measure = float(np.abs(blur_px).mean())
            if np.abs(blur_px).max() <= SHARP_PX:
                return image, measure
            return encode(blurred_by_layers(decode(image), blur_px)), measure

        return focus

    def threshold(self, segment: ShallowFocus) -> float:
        """A mean disc of two pixels."""
        return 2.0


def signed_blur_px(depth_m: np.ndarray, scale_px: float, focus_m: float) -> np.ndarray:
    """(H, W) float32 diameter of each pixel's disc, below 0 in front of what is sharp.

    Args:
        depth_m: (H, W) float32, 0 for very far.
        scale_px: opening times focal length, metres times pixels.
        focus_m: depth of what is sharp.
    """
    inverse = np.divide(1, depth_m, out=np.zeros_like(depth_m), where=depth_m > 0)
    return np.clip(np.float32(scale_px) * (np.float32(1 / focus_m) - inverse), -_MOST_PX, _MOST_PX)


def blurred_by_layers(light: np.ndarray, blur_px: np.ndarray) -> np.ndarray:
    """(H, W) float32 light, each layer of depth spread over its disc.

    Args:
        light: (H, W) float32.
        blur_px: (H, W) float32, as of ``signed_blur_px``.
    """
    # A layer is a step of the logarithm of the blur; 0 is sharp, below it lies what is in front.
    size = np.maximum(np.abs(blur_px) / np.float32(SHARP_PX), 1)
    level = np.log(size) / np.float32(np.log(_STEP)) * np.sign(blur_px)
    shown, cover = np.zeros_like(light), np.zeros_like(light)
    for number in range(int(np.floor(level.max())) + 1, int(np.ceil(level.min())) - 2, -1):
        share = np.maximum(1 - np.abs(level - np.float32(number)), 0)
        if not share.any():
            continue
        kernel = disc(round(SHARP_PX * _STEP ** abs(number), 3)) if number else None
        own, over = (
            part if kernel is None else cv2.filter2D(part, -1, kernel, borderType=cv2.BORDER_REFLECT_101)
            for part in (light * share, share)
        )
        shown = shown * (1 - over) + own
        cover = cover * (1 - over) + over
    return shown / np.maximum(cover, _LEAST_COVER)
