"""Dirt and drops on the lens: fixed spots that smear and darken the view."""

import cv2
import numpy as np

from dslab.scenarios.segments import LensDirt
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.degradations.sprites import acting_share, fill_share, filled, smooth_outline
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import decode, encode

# Spots are placed and light is smeared on grids this much coarser than the image.
_COARSE, _SMEAR = 4, 32
# A spot's rim is blurred by this share of its radius: dirt is far out of focus.
_RIM = 0.15
_CORNERS, _MOST_SPOTS = 9, 4000
_PASSING = 0.75  # of the light, through the middle of a spot
_WIDTHS = (0.5, 1.6)  # of a spot, about the mean


class LensDirtDegradation(ImageDegradation[LensDirt]):
    """Covers part of the view with soft spots that smear and darken the scene."""

    kind = "lens_dirt"
    stage = Stage.LENS
    measure_name = "dirty_share"

    def prepare(self, segment: LensDirt, camera: Intrinsics, streams: Streams) -> Filter:
        cover = dirt_cover(segment, camera, streams("spots"))
        dirty_share = float((cover > 0.5).mean())

        def dirty(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            if dirty_share == 0:
                return image, 0.0
            light = decode(image)
            coarse = (max(1, camera.width_px // _SMEAR), max(1, camera.height_px // _SMEAR))
            smeared = cv2.resize(light, coarse, interpolation=cv2.INTER_AREA)
            smeared = cv2.resize(smeared, (camera.width_px, camera.height_px), interpolation=cv2.INTER_LINEAR)
            scattering = np.float32(_PASSING) * smeared - light
            return encode(light + np.float32(view.strength) * cover * scattering), view.strength * dirty_share

        return dirty

    def threshold(self, segment: LensDirt) -> float:
        """A tenth of the view, or half of a smaller share."""
        return acting_share(segment.share)


def dirt_cover(segment: LensDirt, camera: Intrinsics, rng: np.random.Generator) -> np.ndarray:
    """(H, W) float32 cover, 0 clear to 1 dirty, which exceeds one half on the share.

    The same stream gives the same spots; a larger share has those of a smaller one and more.
    """
    size = (camera.height_px, camera.width_px)
    height, width = (max(8, pixels // _COARSE) for pixels in size)
    spot = float(np.deg2rad(segment.spot_deg) * camera.fx * width / camera.width_px)
    cover = np.zeros((height, width), np.float32)

    def draw_next() -> float:
        radius = max(0.8, float(spot / 2 * np.exp(rng.uniform(*np.log(_WIDTHS)))))
        centre = rng.uniform(0, [width, height])
        spot_cover = filled(cover.shape, centre + radius * _outline(rng))
        np.maximum(cover, cv2.GaussianBlur(spot_cover, (0, 0), _RIM * radius), out=cover)
        return float((cover > 0.5).mean())

    fill_share(segment.share, draw_next, _MOST_SPOTS)
    return cv2.resize(cover, (camera.width_px, camera.height_px))


def _outline(rng: np.random.Generator) -> np.ndarray:
    """(N, 2) outline of a spot of radius 1, uneven."""
    angle = np.linspace(0, 2 * np.pi, _CORNERS, endpoint=False)
    radius = rng.uniform(0.75, 1.25, _CORNERS)
    return smooth_outline(radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
