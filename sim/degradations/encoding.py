"""What the coding of the video and its way to the receiver do: JPEG artefacts, lost packets."""

import cv2
import numpy as np

from dslab.scenarios.segments import BandwidthLoss, Jpeg
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.degradations.sprites import acting_share
from dslab.sim.sensors.camera import Intrinsics

_GRAY = 128  # of blocks before which none has arrived
_LEAST_PACKET, _MOST_PACKET = 3, 40  # blocks
_MOST_ROWS_UP = 6


class JpegDegradation(ImageDegradation[Jpeg]):
    """Encodes and decodes the frame."""

    kind = "jpeg"
    stage = Stage.ENCODER
    measure_name = "jpeg_loss"
    takes_colour = True

    def prepare(self, segment: Jpeg, camera: Intrinsics, streams: Streams) -> Filter:
        """See ``ImageDegradation``; libjpeg's quality is a whole number."""

        def code(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            quality = round(100 - view.strength * (100 - segment.quality))
            if quality == 100:
                return image, 0.0
            _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
            mode = cv2.IMREAD_GRAYSCALE if image.ndim == 2 else cv2.IMREAD_COLOR
            return np.asarray(cv2.imdecode(data, mode)), 100.0 - quality

        return code

    def threshold(self, segment: Jpeg) -> float:
        """A quality of 50, or the segment's own if higher."""
        return min(50.0, 100.0 - round(segment.quality))


class BandwidthLossDegradation(ImageDegradation[BandwidthLoss]):
    """Loses runs of blocks, in the order in which blocks are sent, row by row.

    A lost packet is either smeared, flat at the mean of the last block before it, or read wrongly: then its
    blocks are those of some rows above. Nothing is taken from earlier frames: each is coded by itself.
    """

    kind = "bandwidth_loss"
    stage = Stage.ENCODER
    measure_name = "lost_share"

    def prepare(self, segment: BandwidthLoss, camera: Intrinsics, streams: Streams) -> Filter:
        side = segment.block_px
        rows, columns = -(-camera.height_px // side), -(-camera.width_px // side)
        count = rows * columns

        def lose(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            rng = streams(view.frame)
            # Drawn alike for every share: a larger one loses the packets of a smaller one and more.
            lengths = rng.integers(_LEAST_PACKET, _MOST_PACKET + 1, count)
            packet = np.repeat(np.arange(count), lengths)[:count]
            luck, rows_up = rng.random(count)[packet], rng.integers(-_MOST_ROWS_UP, _MOST_ROWS_UP, count)
            lost = luck < view.strength * segment.share
            if not lost.any():
                return image, 0.0
            blocks = _blocks(image, rows, columns, side)
            last = np.maximum.accumulate(np.where(lost, -1, np.arange(count)))
            means = blocks.mean(axis=(1, 2)).astype(np.uint8)
            flat = np.where(last >= 0, means[last], _GRAY).astype(np.uint8)
            source = np.arange(count) - columns * rows_up[packet]
            misread = lost & (rows_up[packet] > 0) & (source >= 0)
            shown = blocks.copy()
            shown[lost] = flat[lost, None, None]
            shown[misread] = blocks[source[misread]]
            return _image(shown, rows, columns)[: image.shape[0], : image.shape[1]], float(lost.mean())

        return lose

    def threshold(self, segment: BandwidthLoss) -> float:
        """A tenth of the blocks, or half of a smaller share."""
        return acting_share(segment.share)


def _blocks(image: np.ndarray, rows: int, columns: int, side: int) -> np.ndarray:
    """(rows * columns, side, side) uint8 blocks, row by row; those at the border repeat its pixels."""
    missing = ((0, rows * side - image.shape[0]), (0, columns * side - image.shape[1]))
    padded = np.pad(image, missing, mode="edge")
    return padded.reshape(rows, side, columns, side).swapaxes(1, 2).reshape(-1, side, side)


def _image(blocks: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """The image of blocks; the inverse of ``_blocks``."""
    side = blocks.shape[1]
    image = blocks.reshape(rows, columns, side, side).swapaxes(1, 2)
    return np.ascontiguousarray(image.reshape(rows * side, columns * side))
