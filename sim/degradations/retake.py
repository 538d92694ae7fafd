"""Recorded frames taken again: turned, faded and with a longer shutter, as a frame plan says."""

import math
from functools import cached_property, lru_cache

import cv2
import numpy as np

from dslab.scenarios.seeds import rng_for
from dslab.sim.degradations.base import FramePlan
from dslab.sim.degradations.frame_interpolation import FrameInterpolation
from dslab.sim.degradations.turned_view import TurnedView
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.exposure import GRID_PX, PX_PER_SAMPLE, SHARP_PX
from dslab.sim.sensors.tone import decode, encode, linear_to_srgb
from dslab.sim.sequence import FrameSource, Sequence

_LEAST_SAMPLES, _MOST_SAMPLES = 4, 64
# The smear of the fastest pixels but these decides on the number of samples.
_FAST_SHARE = 0.95
_NOISE_FRAMES = 9
DETAIL_DEG = 4.0
"""Standard deviation of the Gaussian whose mean is no detail, visual angle: features of every scale are."""
_TILE = 8
_DARK, _BRIGHT = 8, 247
_NARROW_DEG = 3.0
"""Half of the width of the widest hole that is filled, visual angle."""


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
        shown: what the result shows, ``sequence.frames`` or these in colour; the motion is found in gray.

    Attributes:
        recorded: the frame of a number in ``shown``; those of one exposure are kept.
    """

    def __init__(
        self, sequence: Sequence, plan: FramePlan, view: TurnedView, shown: FrameSource | None = None
    ) -> None:
        self._sequence, self._plan, self._view = sequence, plan, view
        self._shown = sequence.frames if shown is None else shown
        self._contrast = np.where(plan.view_share > 0, plan.contrast, 1.0).prod(axis=1)
        interval_s = np.diff(plan.stamps_s).min(initial=np.inf)
        intervals = 2 + int(plan.exposure_s.max(initial=0.0) / interval_s)
        self.recorded = lru_cache(intervals + 1)(self._shown.__getitem__)
        self._between = FrameInterpolation(
            lambda frame: sequence.frames[frame], self._light, plan.stamps_s, intervals
        )

    def image(self, frame: int) -> tuple[np.ndarray, float]:
        """The (h, w) or (h, w, 3) uint8 frame of a number, and its added smear: the median, pixels."""
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
        """(H, W) float32 light of a recorded frame, faded; of one in colour (H, W, 3), here as below."""
        light = decode(self.recorded(frame))
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
        if not np.any(sigma):
            return encode(light)
        noise = rng_for(self._plan.seed, "degradation", "faded_noise", frame).standard_normal(light.shape)
        levels = 255 * linear_to_srgb(np.clip(light, 0, 1)) + sigma * noise
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)

    @cached_property
    def _noise_sigma(self) -> np.ndarray:
        """Standard deviation of the recording's noise, levels, over all of its time; of each channel."""
        chosen = np.unique(np.linspace(0, len(self._sequence) - 1, _NOISE_FRAMES).astype(int))
        images = [self._shown[frame] for frame in chosen.tolist()]
        sigmas = [
            noise_level(image) if image.ndim == 2 else [noise_level(image[..., at]) for at in range(3)]
            for image in images
        ]
        return np.median(sigmas, axis=0)


def fade(light: np.ndarray, contrast: float, camera: Intrinsics) -> np.ndarray:
    """Multiply the contrast of detail: light relative to its local mean.

    The mean of every surface stays, and so does the shading over more than some degrees.

    Args:
        light: (H, W) float32, 0 to 1.
        contrast: share of the contrast that remains.
        camera: intrinsics of the frame.

    Returns:
        (H, W) float32.
    """
    if contrast == 1:
        return light
    width_px = math.tan(math.radians(DETAIL_DEG)) * camera.fx
    mean = cv2.GaussianBlur(light, (0, 0), width_px, borderType=cv2.BORDER_REFLECT_101)
    return mean + np.float32(contrast) * (light - mean)


def noise_level(gray: np.ndarray) -> float:
    """Standard deviation of the white noise of a frame, grey levels, from its quietest parts.

    Args:
        gray: (H, W) uint8.
    """
    height, width = (size // (2 * _TILE) * 2 * _TILE for size in gray.shape)
    even = gray[:height, :width].astype(np.float32)
    # A diagonal difference sees no shading and no upright or level edge.
    diagonal = (even[::2, ::2] - even[1::2, ::2] - even[::2, 1::2] + even[1::2, 1::2]) / 2
    tiles = diagonal.reshape(height // 2 // _TILE, _TILE, width // 2 // _TILE, _TILE)
    means = even.reshape(height // 2 // _TILE, 2 * _TILE, width // 2 // _TILE, 2 * _TILE).mean(axis=(1, 3))
    spread = np.sqrt((tiles**2).mean(axis=(1, 3)))[(means > _DARK) & (means < _BRIGHT)]
    return float(np.quantile(spread, 0.25)) if spread.size else 0.0


def fill_narrow_holes(depth_m: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """Give narrow holes the depth of the nearest pixel that has one; wide ones stay.

    A depth sensor leaves holes along outlines and on dark or shiny surfaces, which are as near as what is
    about them. Where nothing is within its reach, such as the sky, the hole is wide.

    Args:
        depth_m: (H, W) float32, 0 for none; left unchanged.
        camera: intrinsics of the image.

    Returns:
        (H, W) float32; the given image if it has no hole or no depth.
    """
    hole = depth_m <= 0
    if not hole.any() or hole.all():
        return depth_m
    distance_px, label = cv2.distanceTransformWithLabels(
        hole.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    count, hole_of = cv2.connectedComponents(hole.astype(np.uint8), connectivity=4)
    half_px = np.zeros(count, np.float32)
    np.maximum.at(half_px, hole_of[hole], distance_px[hole])
    narrow = hole & (half_px[hole_of] <= np.radians(_NARROW_DEG) * camera.fx)
    depth_of = np.zeros(int(label.max()) + 1, np.float32)
    depth_of[label[~hole]] = depth_m[~hole]
    return np.where(narrow, depth_of[label], depth_m)
