"""Unguided matching of two images, filtered by grid-based motion statistics (GMS).

Source: Bian, Lin, Matsushita, Yeung, Nguyen, Cheng, "GMS: grid-based motion statistics for fast, ultra-robust
feature correspondence", 2017, as OpenCV has it.
"""

import cv2
import numpy as np

from dslab.slam.core.frame import FrameFeatures
from dslab.slam.core.settings import setting, settings
from dslab.slam.matching.brute_force import match_brute_force

_ANY_DISTANCE = 256
_ANY_RATIO = 1e3


@settings
class GmsConfig:
    """Settings of GMS."""

    threshold_factor: float = setting(6.0, "support a match needs around it; alpha in the paper")
    max_octave: int = setting(7, "matches on coarser pyramid levels are removed, but count as support")
    with_rotation: bool = setting(False, "also try multiples of 45 degrees, at 8 times the cost")
    with_scale: bool = setting(False, "also try scales of sqrt(2) up to 2, at 5 times the cost")


def match_gms(
    a: FrameFeatures,
    b: FrameFeatures,
    size_px: tuple[int, int],
    config: GmsConfig | None = None,
) -> np.ndarray:
    """Match two frames without limits on the keypoints' motion.

    Args:
        a, b: the frames.
        size_px: width and height of their images.
        config: settings, the defaults if None.

    Returns:
        (K, 2) int32 rows (keypoint of A, keypoint of B), by keypoint of A; no keypoint occurs twice. Empty
        if either frame is.
    """
    config = config or GmsConfig()
    # No test of single matches: their neighbours disambiguate those of repeated patterns.
    nearest = match_brute_force(a.descriptors, b.descriptors, _ANY_DISTANCE, _ANY_RATIO)
    if not len(nearest):
        return nearest
    # The grid covers the distorted input image, so that no keypoint lies outside.
    kept = cv2.xfeatures2d.matchGMS(
        size_px,
        size_px,
        cv2.KeyPoint.convert(a.xy_image),
        cv2.KeyPoint.convert(b.xy_image),
        [cv2.DMatch(i, j, 0.0) for i, j in nearest.tolist()],
        withRotation=config.with_rotation,
        withScale=config.with_scale,
        thresholdFactor=config.threshold_factor,
    )
    pairs = np.array([(m.queryIdx, m.trainIdx) for m in kept], np.int32).reshape(-1, 2)
    return pairs[a.octave[pairs[:, 0]] <= config.max_octave]
