"""Detail that is too faint for corners: images amplified as far as their noise allows."""

import cv2
import numpy as np

_NOISE_GAIN = 6.0  # noise of 1 in its second difference of second differences
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
    above, row, below = (image[k : k + image.shape[0] - 2 : 4].astype(np.int16) for k in range(3))
    bend = above - 2 * row + below
    # Zero on whatever changes evenly.
    response = np.abs(bend[:, :-2] - 2 * bend[:, 1:-1] + bend[:, 2:])
    up_to = np.cumsum(np.bincount(response.ravel()))
    middle = np.searchsorted(up_to, [(response.size + 1) // 2, response.size // 2 + 1])
    return max(float(middle.mean()) / (_MEDIAN_OF_NORMAL * _NOISE_GAIN), _ROUNDING)


class Amplifier:
    """Amplifies images of one size; it owns its buffers, since fresh ones would take twice the time."""

    def __init__(self, sizes: list[tuple[int, int]]) -> None:
        """Allocate the buffers.

        Args:
            sizes: height and width of each level of the pyramid, that of the images first.
        """
        self._sizes = sizes
        height, width = sizes[0]
        n_padded = (height + _COARSER) * (width + _COARSER)
        # Each level is made from the one before, so that two take turns.
        self._levels = [np.empty(height * width, np.float32) for _ in range(2)]
        self._smooth = np.empty(height * width, np.float32)
        self._padded = np.empty(n_padded, np.float32)

    def amplify(self, image: np.ndarray, threshold: float, out: list[np.ndarray]) -> None:
        """Make a pyramid, each level amplified until its noise nearly reaches a threshold.

        Noise falls with the size of a level's pixels, so that coarse levels show what is fainter still.

        Args:
            image: (H, W) uint8.
            threshold: contrast in grey levels that noise shall hardly ever reach.
            out: per level (h, w) uint8, receives it around middle grey, saturated where contrast is high.
        """
        noise = noise_of(image)
        step = 0.0 if noise >= _DITHERED else _STEP
        finer = image
        for k, (height, width) in enumerate(self._sizes):
            level = _view(self._levels[k % 2], height, width)
            if k == 0:
                np.copyto(level, image)
            else:
                cv2.resize(finer, (width, height), dst=level, interpolation=cv2.INTER_LINEAR)
            pixel = image.shape[1] / width
            left = noise / (2 * np.sqrt(np.pi) * _SMOOTHING_PX * pixel)  # of white noise behind the smoothing
            gain = threshold / max(_CLEAR * left, step)
            smooth = cv2.GaussianBlur(level, (0, 0), _SMOOTHING_PX, dst=_view(self._smooth, height, width))
            around = self._surroundings(level)
            cv2.addWeighted(smooth, gain, around, -gain, 128.0, dst=out[k], dtype=cv2.CV_8U)
            finer = level

    def _surroundings(self, level: np.ndarray) -> np.ndarray:
        """(h, w) float32 mean of the surroundings; it has no edges of its own, which a box would have."""
        height, width = level.shape
        # Whole blocks: means of broken ones take ten times as long.
        blocks = (-(-width // _COARSER), -(-height // _COARSER))
        padded = _view(self._padded, blocks[1] * _COARSER, blocks[0] * _COARSER)
        below, right = padded.shape[0] - height, padded.shape[1] - width
        cv2.copyMakeBorder(level, 0, below, 0, right, cv2.BORDER_REPLICATE, dst=padded)
        coarse = cv2.resize(padded, blocks, interpolation=cv2.INTER_AREA)
        coarse = cv2.GaussianBlur(coarse, (0, 0), _AROUND_PX / _COARSER)
        cv2.resize(coarse, padded.shape[::-1], dst=padded, interpolation=cv2.INTER_CUBIC)
        return padded[:height, :width]


def _view(buffer: np.ndarray, height: int, width: int) -> np.ndarray:
    return buffer[: height * width].reshape(height, width)
