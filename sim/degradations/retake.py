"""Recorded frames taken again: turned, faded and with a longer shutter, as a frame plan says."""

from functools import cached_property

import numpy as np

from dslab.scenarios.seeds import rng_for
from dslab.sim.degradations.base import FramePlan
from dslab.sim.degradations.faded_detail import fade, noise_level
from dslab.sim.degradations.frame_interpolation import FrameInterpolation
from dslab.sim.degradations.tone import decode, encode
from dslab.sim.degradations.turned_view import TurnedView
from dslab.sim.sensors.exposure import GRID_PX, PX_PER_SAMPLE, SHARP_PX, linear_to_srgb
from dslab.sim.sequence import Sequence

_LEAST_SAMPLES, _MOST_SAMPLES = 4, 64
# The smear of the fastest pixels but these decides on the number of samples.
_FAST_SHARE = 0.95
_NOISE_FRAMES = 9


class Retake:
    """The frames of a recording as a frame plan changes them; all else stays, bit for bit.

    In the order in which light would meet them: the detail of frames fades (``fade``), the camera turns
    (``TurnedView``), the shutter sums light over its time. Of the open shutter, light is taken at times so
    dense that a smear shows no steps, from frames interpolated along the optical flow, and averaged as linear
    light. The smear comes on top of what the recording has. Noise that fading has weakened is added again, as
    a sensor adds it to whatever it sees; then levels are rounded to 8 bits.

    Args:
        sequence: the recording.
        plan: of all of its frames, before any is dropped. Its motion is what the camera turns besides its
            own, its ``exposure_s`` how much longer the shutter is open; a surface fills the view of the
            frames that fade together.
        view: the window of the turned camera.
    """

    def __init__(self, sequence: Sequence, plan: FramePlan, view: TurnedView) -> None:
        self._sequence, self._plan, self._view = sequence, plan, view
        self._contrast = np.where(plan.view_share > 0, plan.contrast, 1.0).prod(axis=1)
        interval_s = np.diff(plan.stamps_s).min(initial=np.inf)
        intervals = 2 + int(plan.exposure_s.max(initial=0.0) / interval_s)
        self._between = FrameInterpolation(
            lambda frame: sequence.frames[frame], self._light, plan.stamps_s, intervals
        )

    def image(self, frame: int) -> tuple[np.ndarray, float]:
        """The (h, w) uint8 frame of a number, and the median length of its added smear in pixels."""
        stamp_s, open_s = float(self._plan.stamps_s[frame]), float(self._plan.exposure_s[frame])
        smear_px = self._smear_px(stamp_s, open_s) if open_s > 0 else np.zeros(1)
        fast_px = float(np.quantile(smear_px, _FAST_SHARE))
        if fast_px < SHARP_PX:
            light = self._view.image(self._light(frame), self._turn(stamp_s))
        else:
            light = self._exposed(stamp_s, open_s, fast_px)
        return self._sensed(light, frame), float(np.median(smear_px))

    def depth(self, frame: int) -> np.ndarray | None:
        """The (h, w) float32 depth of a frame, at the centre of its exposure; None without depth images."""
        if self._sequence.depths is None:
            return None
        return self._view.depth(self._sequence.depths[frame], self._turn(self._plan.stamps_s[frame]))

    def _turn(self, time_s: float) -> np.ndarray:
        return self._plan.motion.T_world_cam(time_s)[:3, :3]

    def _light(self, frame: int) -> np.ndarray:
        """(H, W) float32 light of a recorded frame, faded."""
        light = decode(self._sequence.frames[frame])
        return fade(light, float(self._contrast[frame]), self._sequence.camera)

    def _smear_px(self, stamp_s: float, open_s: float) -> np.ndarray:
        """(n,) length of the smear on a grid of the window, by the optical flow and the turn."""
        begin_s, end_s = stamp_s - open_s / 2, stamp_s + open_s / 2
        shift = self._view.crop(self._between.shift_px(begin_s, end_s))[::GRID_PX, ::GRID_PX]
        begin, end = self._turn(begin_s), self._turn(end_s)
        if not np.array_equal(begin, end):
            shift = shift - (self._view.source(end) - self._view.source(begin))[::GRID_PX, ::GRID_PX]
        return np.hypot(shift[..., 0], shift[..., 1]).ravel()

    def _exposed(self, stamp_s: float, open_s: float, fast_px: float) -> np.ndarray:
        """(h, w) float32 mean of the light over the open shutter."""
        count = int(np.clip(np.ceil(fast_px / PX_PER_SAMPLE), _LEAST_SAMPLES, _MOST_SAMPLES))
        light = np.float32(0)
        for at_s in stamp_s + open_s * ((np.arange(count) + 0.5) / count - 0.5):
            light = light + self._view.image(self._between.at(at_s), self._turn(at_s))
        return np.asarray(light / np.float32(count))

    def _sensed(self, light: np.ndarray, frame: int) -> np.ndarray:
        """(h, w) uint8 image of light, with the noise that fading has weakened."""
        contrast = self._contrast[frame]
        sigma = self._noise_sigma * np.sqrt(1 - contrast**2)
        if sigma == 0:
            return encode(light)
        noise = rng_for(self._plan.seed, "degradation", "faded_noise", frame).standard_normal(light.shape)
        levels = 255 * linear_to_srgb(np.clip(light, 0, 1)) + sigma * noise
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)

    @cached_property
    def _noise_sigma(self) -> float:
        """Standard deviation of the recording's noise, grey levels, over all of its time."""
        chosen = np.unique(np.linspace(0, len(self._sequence) - 1, _NOISE_FRAMES).astype(int))
        return float(np.median([noise_level(self._sequence.frames[frame]) for frame in chosen.tolist()]))
