"""Low light: a darker image with shot and read noise."""

import numpy as np

from dslab.scenarios.segments import LowLight
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import DECODE, ENCODE

ONE_STOP = 1.0
_BANK_SIZE = 1 << 22
# Normal numbers are one-byte codes, this many per standard deviation: up to four deviations either way.
_CODES_PER_SIGMA = 32


class LowLightDegradation(ImageDegradation[LowLight]):
    """Scales the light, adds electron noise, amplifies and saturates."""

    kind = "low_light"
    stage = Stage.SENSOR
    measure_name = "light_lost_stops"

    def prepare(self, segment: LowLight, camera: Intrinsics, streams: Streams) -> Filter:
        return _LowLight(segment, camera, streams)

    def threshold(self, segment: LowLight) -> float:
        """One stop, or the whole loss if smaller."""
        return min(ONE_STOP, -float(np.log2(segment.illumination)))


class _LowLight:
    """Noise by a table over a pixel's level and a normal number."""

    def __init__(self, segment: LowLight, camera: Intrinsics, streams: Streams) -> None:
        self._segment, self._streams = segment, streams
        self._pixels = camera.width_px * camera.height_px
        size = max(_BANK_SIZE, 2 * self._pixels)
        normals = streams("bank").standard_normal(size, np.float32)
        self._bank = np.clip(np.rint(_CODES_PER_SIGMA * normals) + 128, 0, 255).astype(np.uint8)
        self._strength, self._table = 0.0, np.empty((256, 256), np.uint8)

    def __call__(self, image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
        illumination = 1 - view.strength * (1 - self._segment.illumination)
        if illumination == 1:
            return image, 0.0
        if view.strength != self._strength:
            gain = 1 + view.strength * (self._segment.gain - 1)
            self._table = noise_table(
                illumination, gain, self._segment.full_well_e, self._segment.read_noise_e
            )
            self._strength = view.strength
        start = int(self._streams(*view.noise_names).integers(len(self._bank) - self._pixels))
        codes = self._bank[start : start + self._pixels].reshape(image.shape)
        return self._table[image, codes], -float(np.log2(illumination))


def noise_table(illumination: float, gain: float, full_well_e: float, read_noise_e: float) -> np.ndarray:
    """(256, 256) uint8 noisy level of every level and code of a normal number.

    ``illumination`` is the light as a share of that behind the levels. Shot noise is approximated as normal
    with the variance of its mean count, which holds from about ten electrons on; below, read noise dominates.
    """
    electrons = illumination * full_well_e * DECODE.astype(float)[:, None]
    normal = (np.arange(256) - 128) / _CODES_PER_SIGMA
    counted = electrons + np.sqrt(electrons + read_noise_e**2) * normal
    light = np.clip(gain * counted / full_well_e, 0, 1)
    return ENCODE[np.rint(light * (len(ENCODE) - 1)).astype(int)]
