"""Detail that is too faint for corners: images amplified as far as their noise allows."""

import cv2
import numpy as np

# The second difference of second differences: zero on whatever changes evenly; noise of 1 becomes 6.
_NOISE_MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
_NOISE_GAIN = 6.0
_MEDIAN_OF_NORMAL = 0.6745  # of the absolute value, in standard deviations
_ROUNDING = 0.29  # standard deviation of rounding to whole grey levels
_SMOOTHING_PX = 0.8  # of each level
_COARSER = 8  # size of the pixels of the image's surroundings
_AROUND_PX = 24  # standard deviation of the surroundings, whose mean becomes middle grey
_CLEAR = 4.5  # contrasts of so many standard deviations of noise are detail
_DITHERED = 0.5  # noise of so many grey levels and more leaves no edges where even shading is rounded
_STEP = 1.2  # contrast of such an edge


def noise_of(image: np.ndarray) -> float:
    """Standard deviation of the noise of pixels, in grey levels, at least that of rounding.

    Fine texture over more than half of the image counts as noise.

    Args:
        image: (H, W) uint8.

    Source: Immerkaer, "Fast Noise Variance Estimation", CVIU 1996: its mask, with the median for the mean.
    """
    response = cv2.filter2D(image, cv2.CV_32F, _NOISE_MASK)[1:-1:4, 1:-1]
    return max(float(np.median(np.abs(response))) / (_MEDIAN_OF_NORMAL * _NOISE_GAIN), _ROUNDING)


def amplified(image: np.ndarray, sizes: list[tuple[int, int]], threshold: float) -> list[np.ndarray]:
    """Pyramid of an image, each level smoothed and amplified until its noise nearly reaches a threshold.

    Noise falls with the size of a level's pixels, so that coarse levels show what is fainter still.

    Args:
        image: (H, W) uint8.
        sizes: height and width of each level, that of the image first.
        threshold: contrast in grey levels that noise shall hardly ever reach.

    Returns:
        Per level (h, w) uint8 around middle grey, saturated where contrast is high.
    """
    noise = noise_of(image)
    step = 0.0 if noise >= _DITHERED else _STEP
    level, levels = image.astype(np.float32), []
    for height, width in sizes:
        if level.shape != (height, width):
            level = cv2.resize(level, (width, height), interpolation=cv2.INTER_LINEAR)
        pixel = image.shape[1] / width
        left = noise / (2 * np.sqrt(np.pi) * _SMOOTHING_PX * pixel)  # of white noise behind the smoothing
        gain = threshold / max(_CLEAR * left, step)
        smooth = cv2.GaussianBlur(level, (0, 0), _SMOOTHING_PX)
        around = _surroundings(level)
        levels.append(cv2.addWeighted(smooth, gain, around, -gain, 128.0, dtype=cv2.CV_8U))
    return levels


def _surroundings(level: np.ndarray) -> np.ndarray:
    """(h, w) float32 mean of the surroundings; it has no edges of its own, which a box would have."""
    height, width = level.shape
    small = (max(width // _COARSER, 1), max(height // _COARSER, 1))
    coarse = cv2.resize(level, small, interpolation=cv2.INTER_AREA)
    coarse = cv2.GaussianBlur(coarse, (0, 0), _AROUND_PX / _COARSER)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
