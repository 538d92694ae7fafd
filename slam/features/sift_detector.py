"""SIFT keypoints and descriptors of an image, from its own resolution up or from a coarser one.

Lowe and OpenCV double the image first; that octave costs four times the next and is left out here.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from dslab.slam.features._dog_kernels import BORDER_PX, LAYERS, find_extrema, refine_extrema
from dslab.slam.features._sift_kernels import describe, orient

SIGMA0_PX = 1.6
"""Standard deviation of the finest Gaussian."""

_CAMERA_SIGMA_PX = 0.5  # that the image is assumed to have (Lowe, Sec. 3.3)
_REACH = 3.0  # standard deviations to which a Gaussian is computed
_MOST_EXTREMA = 20000  # per octave
_ORIENTATIONS = 4  # most per keypoint, on average


@dataclass(frozen=True)
class SiftFeatures:
    """SIFT features of an image, octave by octave.

    Attributes:
        xy: (n, 2) float64 keypoints, px.
        sigma_px: (n,) float64 scales: standard deviations of the Gaussian.
        turns: (n,) float64 orientations from the x to the y axis, in turns.
        descriptors: (n, 128) uint8, of length 512.
    """

    xy: np.ndarray
    sigma_px: np.ndarray
    turns: np.ndarray
    descriptors: np.ndarray


class SiftDetector:
    """Detects the SIFT features of images; its buffers serve one image after the other.

    Args:
        n_keypoints: most keypoints kept, strongest first; each orientation of one gives a feature.
        contrast: least contrast of a keypoint, as a share of the grey range, in OpenCV's sense: its usual
            value is .04, Lowe's .03 is .09 there.
        octaves: most octaves.
        most_pixels: a larger image is reduced to this number of pixels first.

    Source: Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 2004.
    """

    def __init__(self, n_keypoints: int, contrast: float, octaves: int, most_pixels: int) -> None:
        self._n_keypoints = n_keypoints
        self._least = 255 * contrast / LAYERS
        self._octaves = octaves
        self._most_pixels = most_pixels
        self._shape: tuple[int, ...] = ()
        self._gaussians: list[np.ndarray] = []
        self._found = np.empty((_MOST_EXTREMA, 3), np.int32)
        self._refined = np.empty((_MOST_EXTREMA, 5))

    def detect(self, image: np.ndarray) -> SiftFeatures:
        """Detect the features of an image (H, W) uint8."""
        height, width = image.shape
        share = np.sqrt(self._most_pixels / image.size)
        if share < 1:
            size = max(1, round(share * width)), max(1, round(share * height))
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        if image.shape != self._shape:
            self._make_buffers(image.shape)
        keypoints = self._keypoints(image)
        parts = [self._describe(o, keypoints[o]) for o in range(len(keypoints)) if len(keypoints[o])]
        if not parts:
            return SiftFeatures(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty((0, 128), np.uint8))
        xy, sigma_px, turns, descriptors = (np.concatenate(part) for part in zip(*parts, strict=True))
        per_px = np.array([width, height]) / image.shape[::-1]
        return SiftFeatures((xy + 0.5) * per_px - 0.5, sigma_px * per_px[0], turns, descriptors)

    def _make_buffers(self, shape: tuple[int, ...]) -> None:
        self._shape, self._gaussians = shape, []
        self._dog = np.empty((LAYERS + 2) * shape[0] * shape[1], np.float32)
        while len(self._gaussians) < self._octaves and min(shape) > 2 * BORDER_PX:
            self._gaussians.append(np.empty((LAYERS + 3, *shape), np.float32))
            shape = ((shape[0] + 1) // 2, (shape[1] + 1) // 2)

    def _keypoints(self, image: np.ndarray) -> list[np.ndarray]:
        """Fill the scale space; the strongest keypoints (n, 5) of each octave, as of ``refine_extrema``."""
        found = []
        for octave, gaussians in enumerate(self._gaussians):
            if octave == 0:
                _blur(image.astype(np.float32), np.sqrt(SIGMA0_PX**2 - _CAMERA_SIGMA_PX**2), gaussians[0])
            else:
                gaussians[0] = self._gaussians[octave - 1][LAYERS, ::2, ::2]
            for i in range(LAYERS + 2):
                _blur(gaussians[i], SIGMA0_PX * 2 ** (i / LAYERS) * _STEP, gaussians[i + 1])
            dog = self._dog[: gaussians[1:].size].reshape(gaussians[1:].shape)
            np.subtract(gaussians[1:], gaussians[:-1], out=dog)
            count = find_extrema(dog, np.float32(0.5 * self._least), self._found)
            count = refine_extrema(dog, self._found, count, self._least, self._refined)
            found.append(self._refined[:count].copy())
        sizes = np.concatenate([k[:, 3] for k in found]) if found else np.empty(0)
        kept = np.zeros(len(sizes), np.bool_)
        kept[np.argsort(-sizes, kind="stable")[: self._n_keypoints]] = True
        ends = np.cumsum([len(k) for k in found])
        return [k[kept[end - len(k) : end]] for k, end in zip(found, ends, strict=True)]

    def _describe(self, octave: int, keypoints: np.ndarray) -> tuple[np.ndarray, ...]:
        gaussians = self._gaussians[octave]
        turns = np.empty(_ORIENTATIONS * len(keypoints))
        owners = np.empty(len(turns), np.int32)
        count = orient(gaussians, keypoints, SIGMA0_PX, turns, owners)
        turns, owners = turns[:count], owners[:count]
        descriptors = np.empty((count, 128), np.uint8)
        describe(gaussians, keypoints, turns, owners, SIGMA0_PX, descriptors)
        sigma_px = SIGMA0_PX * 2.0 ** (octave + keypoints[owners, 2] / LAYERS)
        return keypoints[owners, :2] * 2**octave, sigma_px, turns, descriptors


_STEP = np.sqrt(
    2 ** (2 / LAYERS) - 1
)  # the blur between neighbouring Gaussians, in standard deviations of the first


def _blur(image: np.ndarray, sigma_px: float, out: np.ndarray) -> None:
    side = 2 * int(np.ceil(_REACH * sigma_px)) + 1
    cv2.GaussianBlur(image, (side, side), sigma_px, dst=out)
