"""Dirt and drops on the lens: spots that stay in place and show a smeared veil."""

from typing import ClassVar

import cv2
import numpy as np

from scenarios.segments import LensDirt
from sim.camera import Intrinsics
from sim.degradations.base import Stage
from sim.degradations.image import Filter, ImageDegradation, Streams, View
from sim.degradations.tone import decode, encode

FELT_SHARE = 0.1
# Spots are laid out and light is smeared on grids this much coarser than the image.
_COARSE, _SMEAR = 4, 32
# A spot's rim fades over this share of its radius: dirt lies far out of focus.
_RIM = 0.35
_PASSING = 0.75  # of the light, through the middle of a spot
_WIDTHS = (0.5, 1.6)  # of a spot, about the mean


class LensDirtDegradation(ImageDegradation[LensDirt]):
    """Covers part of the view with soft spots through which the scene is smeared and darker."""

    kind: ClassVar[str] = "lens_dirt"
    stage: ClassVar[Stage] = Stage.LENS
    measure_name: ClassVar[str] = "dirty_share"

    def sample(self, rng: np.random.Generator) -> dict[str, float | str]:
        """Share of the view, uniform, and width of the spots."""
        return {"share": float(rng.uniform(0.1, 0.9)), "spot_deg": float(rng.uniform(3, 12))}

    def prepare(self, segment: LensDirt, camera: Intrinsics, streams: Streams) -> Filter:
        """See ``ImageDegradation``."""
        cover = dirt_cover(segment, camera, streams("spots"))
        dirty_share = float((cover > 0.5).mean())

        def dirty(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            if dirty_share == 0:
                return image, 0.0
            light = decode(image)
            coarse = (max(1, camera.width_px // _SMEAR), max(1, camera.height_px // _SMEAR))
            smeared = cv2.resize(light, coarse, interpolation=cv2.INTER_AREA)
            smeared = cv2.resize(smeared, (camera.width_px, camera.height_px), interpolation=cv2.INTER_LINEAR)
            veil = np.float32(_PASSING) * smeared - light
            return encode(light + np.float32(view.strength) * cover * veil), view.strength * dirty_share

        return dirty

    def threshold(self, segment: LensDirt) -> float:
        """A tenth of the view, or half of the share asked for, if that is less."""
        return min(FELT_SHARE, segment.share / 2)


def dirt_cover(segment: LensDirt, camera: Intrinsics, rng: np.random.Generator) -> np.ndarray:
    """(H, W) float32 cover, 0 clear to 1 dirty; spots are added until more than half cover the share.

    The same stream gives the same spots, so that a larger share has those of a smaller one and more.
    """
    size = (camera.height_px, camera.width_px)
    if segment.share == 0:
        return np.zeros(size, np.float32)
    height, width = (max(8, pixels // _COARSE) for pixels in size)
    spot = np.deg2rad(segment.spot_deg) * camera.fx * width / camera.width_px
    y, x = np.mgrid[:height, :width].astype(np.float32)
    cover = np.zeros((height, width), np.float32)
    while (cover > 0.5).mean() < segment.share:
        radius = max(0.8, float(spot / 2 * np.exp(rng.uniform(*np.log(_WIDTHS)))))
        centre_x, centre_y, squash, tilt = rng.uniform([0, 0, 0.7, 0], [width, height, 1, np.pi])
        across, along = x - centre_x, y - centre_y
        first = np.cos(tilt) * across + np.sin(tilt) * along
        second = (np.cos(tilt) * along - np.sin(tilt) * across) / squash
        inward = (1 - np.sqrt(first**2 + second**2) / radius) / _RIM + 0.5
        np.maximum(cover, np.clip(inward, 0, 1), out=cover)
    return cv2.resize(cover.astype(np.float32), (camera.width_px, camera.height_px))
