"""JPEG artefacts."""

import cv2
import numpy as np

from dslab.scenarios.segments import Jpeg
from dslab.sim.degradations.base import Stage, drawn, log_uniform
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.sensors.camera import Intrinsics

FELT_LOSS = 50.0


class JpegDegradation(ImageDegradation[Jpeg]):
    """Encodes and decodes the frame."""

    kind = "jpeg"
    stage = Stage.ENCODER
    measure_name = "jpeg_loss"
    sample = drawn(quality=log_uniform(2, 60))

    def prepare(self, segment: Jpeg, camera: Intrinsics, streams: Streams) -> Filter:
        """See ``ImageDegradation``; libjpeg's quality is a whole number."""

        def code(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            quality = round(100 - view.strength * (100 - segment.quality))
            if quality == 100:
                return image, 0.0
            _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
            return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)), 100.0 - quality

        return code

    def threshold(self, segment: Jpeg) -> float:
        """A quality of 50, or the segment's own if higher."""
        return min(FELT_LOSS, 100.0 - round(segment.quality))
