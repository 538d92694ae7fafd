"""Feature buffer over which a recovery runs backward. Source: paper, Sec. III-A and Fig. 4."""

from collections import deque
from collections.abc import Iterator

import cv2
import numpy as np

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import FrameFeatures

# Of 100: at this quality SIFT finds the same features as in the image, at a fifth of its size.
JPEG_QUALITY = 95


class FeatureBuffer:
    """Features of the most recent frames: a ring buffer that grows while frozen.

    Args:
        span_s: time span of the ring, k of the paper.
        cap_s: largest time span while frozen; beyond it the oldest frames leave.
        images: also hold the frames' images, as JPEG.
    """

    def __init__(self, span_s: float, cap_s: float, images: bool = False) -> None:
        if not 0 < span_s <= cap_s:
            raise ValueError(f"need 0 < span_s <= cap_s, got {span_s} and {cap_s}")
        self.span_s = span_s
        self.cap_s = cap_s
        self.frozen = False
        self._with_images = images
        self._frames: deque[FrameFeatures] = deque()
        self._images: dict[int, bytes] = {}
        self._camera: PinholeCamera | None = None

    def __len__(self) -> int:
        return len(self._frames)

    def __iter__(self) -> Iterator[FrameFeatures]:
        """The frames, oldest first."""
        return iter(self._frames)

    def append(self, features: FrameFeatures, image: np.ndarray | None = None) -> None:
        """Add the newest frame; frames older than the span (while frozen: the cap) leave.

        Args:
            features: the frame's features.
            image: (H, W) uint8; held only if the buffer holds images.
        """
        self._frames.append(features)
        if self._with_images and image is not None:
            self._images[features.index] = _compressed(image)
        limit = self.cap_s if self.frozen else self.span_s
        while features.stamp_s - self._frames[0].stamp_s > limit:
            self._images.pop(self._frames.popleft().index, None)

    def undistort_with(self, camera: PinholeCamera) -> None:
        """Undistort the buffered frames' keypoints anew if this is another camera than the last time."""
        if self._camera is not None and camera != self._camera:
            self._frames = deque(features.seen_by(camera) for features in self._frames)
        self._camera = camera

    def backward_from(self, index: int) -> Iterator[FrameFeatures]:
        """Frames before frame ``index``, newest first."""
        return (f for f in reversed(self._frames) if f.index < index)

    def reaches(self, index: int) -> bool:
        """Return True if frame ``index`` or an older one is still held."""
        return bool(self._frames) and self._frames[0].index <= index

    def images(self) -> "BufferedImages":
        """Return the images held now; they stay available when their frames leave the buffer."""
        return BufferedImages(dict(self._images))

    @property
    def nbytes(self) -> int:
        """Size of the buffered features and images in bytes."""
        return sum(f.nbytes for f in self._frames) + sum(map(len, self._images.values()))


class BufferedImages:
    """Images by frame index, decoded on request."""

    def __init__(self, packed: dict[int, bytes]) -> None:
        self._packed = packed
        self._last: tuple[int, np.ndarray] | None = None

    def __call__(self, index: int) -> np.ndarray:
        """The (H, W) uint8 image of a frame, not to be changed.

        Raises:
            KeyError: the image is not held.
        """
        last = self._last
        if last is not None and last[0] == index:
            return last[1]
        if index not in self._packed:
            raise KeyError(f"frame {index} is not held as an image")
        image = cv2.imdecode(np.frombuffer(self._packed[index], np.uint8), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise ValueError(f"the image of frame {index} cannot be decoded")
        self._last = index, image
        return image


def _compressed(image: np.ndarray) -> bytes:
    packed, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not packed:
        raise ValueError("an image cannot be encoded as JPEG")
    return data.tobytes()
