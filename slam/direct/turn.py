"""The turn of a camera between two frames, by where all that it sees has gone.

For turns that no step-by-step alignment follows.

Source: Klein, Murray, "Improving the agility of keyframe-based SLAM", ECCV 2008, Sec. 3.4, which aligns small
blurred images; the shift is found at once here, by Kuglin, Hines, "The phase correlation image alignment
method", 1975.
"""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from dslab.slam.direct.pyramid import ImagePyramid

_LEAST_WIDTH_PX = 64
"""By hand: a pixel is then a degree of a view of 64, which alignment follows on its coarsest level."""


def level_of(pyramid: ImagePyramid) -> int:
    """The coarsest level of a pyramid on which a turn is sought."""
    wide = (k for k, level in enumerate(pyramid.levels) if level.shape[1] >= _LEAST_WIDTH_PX)
    return max(wide, default=0)


def turn_between(before: np.ndarray, now: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """The rotation between two images, as a motion without translation.

    Args:
        before, now: (H, W) float32 images of one level; NaN where nothing is seen.
        intrinsics: (4,) of that level.

    Returns:
        (4, 4) from the first camera to the second; none where an image has no contrast.
    """
    T = np.eye(4)
    if any(not np.nanstd(image) > 0 for image in (before, now)):
        return T
    before, now = (np.nan_to_num(image, nan=float(np.nanmean(image))) for image in (before, now))
    window = cv2.createHanningWindow((now.shape[1], now.shape[0]), cv2.CV_32F)
    shift, _ = cv2.phaseCorrelate(before - before.mean(), now - now.mean(), window)
    x, y = np.array(shift) / intrinsics[:2]
    angle, axis = np.arctan(np.hypot(x, y)), np.array([-y, x, 0.0]) / max(np.hypot(x, y), 1e-12)
    T[:3, :3] = Rotation.from_rotvec(angle * axis).as_matrix()
    return T
