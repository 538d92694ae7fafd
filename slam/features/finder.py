"""Features of the frames of one camera."""

from dataclasses import replace

import numpy as np

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import Features
from dslab.slam.features.orb import OrbConfig, OrbExtractor
from dslab.slam.features.remembered import Remembered

_PX_PER_FEATURE = 45.0  # an image has room for at most one feature in this many pixels


class FeatureFinder:
    """Finds features in images, and more of them where a map is sought.

    Args:
        camera: of the images.
        config: settings for tracked frames.
        initial_features: how many times as many are found where a map is sought, as far as there is room.
    """

    def __init__(self, camera: PinholeCamera, config: OrbConfig, initial_features: float) -> None:
        width, height = camera.width_px, camera.height_px
        wanted = min(initial_features * config.n_features, width * height / _PX_PER_FEATURE)
        # A map begun from faint corners, in the middle of a blur say, is hardly one.
        more = replace(config, n_features=max(config.n_features, round(wanted)), faint_share=0.0)
        self._usual, self._dense = (OrbExtractor(width, height, c) for c in (config, more))

    def find(self, image: np.ndarray, dense: bool) -> Features:
        """Features of an image (H, W) uint8, ``dense`` as a map is sought."""
        return (self._dense if dense else self._usual).extract(image)

    def remember(self, images: int) -> None:
        """Keep the features of so many images, for copies that see the same ones."""
        for extractor in (self._usual, self._dense):
            extractor.remembered = Remembered(images)
