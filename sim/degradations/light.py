"""Light that is withheld, added or measured wrongly: the kinds that only change how bright a pixel is."""

from abc import abstractmethod

import numpy as np

from dslab.scenarios.segments import (
    AutoExposureLag,
    CoveredLens,
    DayToNight,
    Flicker,
    OverExposure,
    Vignetting,
)
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.image import Filter, ImageDegradation, SegmentT, Streams, View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import decode, encode, map_light

ONE_STOP = 1.0
_BEAM_DEG = 18.0  # standard deviation of the lamp's beam
_FULL_WELL_E, _READ_NOISE_E = 10000.0, 5.0


class Brightness(ImageDegradation[SegmentT]):
    """A kind that multiplies the light of all pixels alike."""

    @abstractmethod
    def gain(self, segment: SegmentT, view: View) -> tuple[float, float]:
        """Factor of the light in a frame, and the frame's measure."""

    def prepare(self, segment: SegmentT, camera: Intrinsics, streams: Streams) -> Filter:
        def expose(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            gain, measure = self.gain(segment, view)
            return map_light(image, lambda light: gain * light), measure

        return expose


class CoveredLensDegradation(Brightness[CoveredLens]):
    """Multiplies the light by the cover's transmission."""

    kind = "covered_lens"
    stage = Stage.LENS
    measure_name = "light_withheld"

    def gain(self, segment: CoveredLens, view: View) -> tuple[float, float]:
        withheld = view.strength * (1 - segment.transmission)
        return 1 - withheld, withheld

    def threshold(self, segment: CoveredLens) -> float:
        """Half of the light, or all that the cover withholds, if that is less."""
        return min(0.5, 1 - segment.transmission)


class OverExposureDegradation(Brightness[OverExposure]):
    """Doubles the exposure once per stop; bright parts saturate."""

    kind = "over_exposure"
    stage = Stage.SENSOR
    measure_name = "over_exposure_stops"

    def gain(self, segment: OverExposure, view: View) -> tuple[float, float]:
        stops = view.strength * segment.stops
        return 2**stops, stops

    def threshold(self, segment: OverExposure) -> float:
        """One stop, or the segment's own stops if fewer."""
        return min(ONE_STOP, segment.stops)


class AutoExposureLagDegradation(Brightness[AutoExposureLag]):
    """Exposure error that starts with the jump's stops and decays exponentially."""

    kind = "auto_exposure_lag"
    stage = Stage.SENSOR
    measure_name = "exposure_error_stops"

    def gain(self, segment: AutoExposureLag, view: View) -> tuple[float, float]:
        since_s = max(0.0, view.stamp_s - segment.start_s)
        stops = view.strength * segment.stops * float(np.exp(-since_s / segment.time_constant_s))
        return 2**stops, abs(stops)

    def threshold(self, segment: AutoExposureLag) -> float:
        """Half a stop, or half of a smaller jump."""
        return min(0.5, abs(segment.stops) / 2)


class VignettingDegradation(ImageDegradation[Vignetting]):
    """Halves the light once per stop; stops grow with the square of the distance from the optical axis."""

    kind = "vignetting"
    stage = Stage.LENS
    measure_name = "vignetting_stops"

    def prepare(self, segment: Vignetting, camera: Intrinsics, streams: Streams) -> Filter:
        x, y = np.arange(camera.width_px) - camera.cx, np.arange(camera.height_px) - camera.cy
        squared = x**2 + y[:, None] ** 2
        share = (squared / squared.max()).astype(np.float32)

        def vignette(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            stops = view.strength * segment.stops
            if stops == 0:
                return image, 0.0
            return encode(decode(image) * np.exp2(np.float32(-stops) * share)), stops

        return vignette

    def threshold(self, segment: Vignetting) -> float:
        """One stop, or the segment's own stops if fewer."""
        return min(ONE_STOP, segment.stops)


class FlickerDegradation(ImageDegradation[Flicker]):
    """Multiplies each row's light by that of the lamps at the row's own time.

    ``1 + modulation cos(2 pi rate t + phase)``; the middle row is read at the frame's stamp. The modulation
    is what the shutter leaves of the lamps' own: an exposure of whole periods would leave none.
    """

    kind = "flicker"
    stage = Stage.SENSOR
    measure_name = "flicker_modulation"

    def prepare(self, segment: Flicker, camera: Intrinsics, streams: Streams) -> Filter:
        phase = streams("phase").uniform(0, 2 * np.pi)
        row_s = ((np.arange(camera.height_px) + 0.5) / camera.height_px - 0.5) * segment.readout_s

        def flicker(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            modulation = view.strength * segment.modulation
            if modulation == 0:
                return image, 0.0
            since_s = view.stamp_s - segment.start_s + row_s
            lamps = 1 + modulation * np.cos(2 * np.pi * segment.rate_hz * since_s + phase)
            return encode(decode(image) * lamps.astype(np.float32)[:, None]), modulation

        return flicker

    def threshold(self, segment: Flicker) -> float:
        """A tenth, or the segment's own modulation if smaller."""
        return min(0.1, segment.modulation)


class DayToNightDegradation(ImageDegradation[DayToNight]):
    """Scales daylight, adds a lamp's beam, counts electrons and amplifies them.

    The camera amplifies as much as the daylight has lost, up to its gain; from then on it gets dark. Shot
    noise is approximated as normal.
    """

    kind = "day_to_night"
    stage = Stage.SENSOR
    measure_name = "night_stops"

    def prepare(self, segment: DayToNight, camera: Intrinsics, streams: Streams) -> Filter:
        off_axis = np.arctan(np.hypot(*camera.rays())) / np.radians(_BEAM_DEG)
        beam = np.exp(-(off_axis**2) / 2).astype(np.float32)

        def darken(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            stops = view.strength * segment.stops
            if stops == 0:
                return image, 0.0
            daylight = 2.0**-stops
            gain = min(segment.gain, 1 / daylight)
            # The lamp is switched on as daylight goes.
            lit = np.float32(daylight) + np.float32(segment.lamp * (1 - daylight)) * beam
            electrons = decode(image) * lit * np.float32(_FULL_WELL_E)
            noise = streams(*view.noise_names).standard_normal(image.shape, np.float32)
            electrons += np.sqrt(electrons + np.float32(_READ_NOISE_E**2)) * noise
            return encode(electrons * np.float32(gain / _FULL_WELL_E)), stops

        return darken

    def threshold(self, segment: DayToNight) -> float:
        """One stop, or the segment's own stops if fewer."""
        return min(ONE_STOP, segment.stops)
