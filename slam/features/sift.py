"""SIFT features of a frame."""

from dataclasses import dataclass

import numpy as np

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import Frame
from dslab.slam.features._sift_matching import nearest
from dslab.slam.features.sift_detector import SIGMA0_PX, SiftFeatures
from dslab.slam.features.tracks import TrackedFrame


@dataclass
class SiftFrame(TrackedFrame):
    """SIFT features of a frame.

    Attributes:
        descriptors: (n, 128) uint8.
    """

    descriptors: np.ndarray


def sift_frame(found: SiftFeatures, frame: Frame, camera: PinholeCamera) -> SiftFrame:
    """The SIFT features of a frame.

    Args:
        found: as detected in its image.
        frame: the frame.
        camera: the camera of the image.
    """
    xy = camera.undistort_points(found.xy.astype(np.float32)).astype(np.float64)
    return SiftFrame(frame, xy, (SIGMA0_PX / found.sigma_px) ** 2, found.descriptors)


def match(a: SiftFrame, b: SiftFrame, ratio: float) -> np.ndarray:
    """(k, 2) rows of ``a`` and ``b`` that are mutual nearest neighbours and pass the ratio test.

    Args:
        a, b: the frames.
        ratio: largest distance ratio of the nearest to the second nearest (Lowe's test).
    """
    if not len(a.xy) or not len(b.xy):
        return np.empty((0, 2), np.int64)
    found, best2, second2, back = nearest(a.descriptors, b.descriptors)
    rows = np.arange(len(a.xy))
    keep = (back[found] == rows) & (best2 < ratio**2 * second2)
    return np.column_stack([rows[keep], found[keep]])
