"""Lens flare: a bright light's glare, streaks and ghosts."""

from dataclasses import dataclass

import cv2
import numpy as np

from dslab.scenarios.segments import LensFlare
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.motion.base import Motion
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import decode, encode

FELT_VEIL = 0.05
_COARSE = 4  # light is added on a grid this much coarser than the image
_GHOSTS, _BLADES = 7, 6
_GLARE_DEG = 1.2  # where the glare about the light begins to fall
_STREAK_DEG = (0.35, 9.0)  # width, and where a streak has half of its light
_GHOST_DEG = (0.7, 4.5)
_EVEN, _STREAKS, _GHOST = 0.01, 0.12, 0.025  # relative to the light's own image
_WELL_INSIDE_DEG, _SIDEWARDS_DEG = 30.0, 80.0


@dataclass(frozen=True)
class _Optics:
    """What a lens makes of a light.

    Attributes:
        turn_rad: of the streaks.
        place: (G,) of each ghost on the line through the light, at 1, and the middle of the view, at 0.
        radius_deg: (G,) of each ghost.
        bright: (G,) light of each ghost.
    """

    turn_rad: float
    place: np.ndarray
    radius_deg: np.ndarray
    bright: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "_Optics":
        """Ghosts on both sides of the middle of the view."""
        place = rng.uniform(-1.6, 0.6, _GHOSTS)
        radius_deg = np.exp(rng.uniform(*np.log(_GHOST_DEG), _GHOSTS))
        return cls(rng.uniform(0, np.pi), place, radius_deg, rng.uniform(0.3, 1, _GHOSTS))


class LensFlareDegradation(ImageDegradation[LensFlare]):
    """Adds light that a lens scatters and reflects.

    Glare falls with the square of the angle from the light, and a small part fills the view evenly. The light
    keeps its direction in the world where the motion is known. Outside the view it adds the less, the farther
    to the side it is. Source: Holladay, 1926 (the glare).
    """

    kind = "lens_flare"
    # It needs the motion, which is known up to the lens.
    stage = Stage.READOUT
    measure_name = "flare_veil"

    def prepare(self, segment: LensFlare, camera: Intrinsics, streams: Streams) -> Filter:
        return _Flare(segment, camera, streams("light"))

    def threshold(self, segment: LensFlare) -> float:
        """A twentieth of white, or half of a smaller veil."""
        return min(FELT_VEIL, segment.veil / 2)


class _Flare:
    """The flare of one segment."""

    def __init__(self, segment: LensFlare, camera: Intrinsics, rng: np.random.Generator) -> None:
        self._segment, self._camera = segment, camera
        around, off = rng.uniform(-np.pi, 0), np.radians(segment.off_axis_deg)  # above the horizon
        self._ray = np.array([np.sin(off) * np.cos(around), np.sin(off) * np.sin(around), np.cos(off)])
        self._optics = _Optics.drawn(rng)
        self._full = float(self._added(self._ray).mean())

    def __call__(self, image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
        veil = view.strength * self._segment.veil
        if veil == 0:
            return image, 0.0
        ray = self._ray
        if view.motion is not None:
            ray = _turn(view.motion, self._segment.start_s, view.stamp_s) @ ray
        added = self._added(ray) * np.float32(veil / self._full)
        wide = cv2.resize(added, image.shape[::-1], interpolation=cv2.INTER_LINEAR)
        return encode(decode(image) + wide), float(added.mean())

    def _added(self, ray: np.ndarray) -> np.ndarray:
        """(h, w) float32 light on the coarse grid from a light in a direction of the camera's frame."""
        camera, optics = self._camera, self._optics
        off = np.arccos(np.clip(ray[2], -1, 1))
        sideways = ray[:2] / max(float(np.hypot(*ray[:2])), 1e-9)
        light = np.tan(min(off, np.radians(_SIDEWARDS_DEG))) * sideways
        height, width = (max(8, side // _COARSE) for side in (camera.height_px, camera.width_px))
        x = ((np.arange(width) + 0.5) * camera.width_px / width - 0.5 - camera.cx) / camera.fx
        y = ((np.arange(height) + 0.5) * camera.height_px / height - 0.5 - camera.cy) / camera.fy
        dx, dy = x - light[0], y[:, None] - light[1]
        squared = np.degrees(1) ** 2 * (dx**2 + dy**2)  # about the angle from the light, squared
        added = _EVEN + _GLARE_DEG**2 / (_GLARE_DEG**2 + squared)
        wide, far = _STREAK_DEG
        for blade in range(_BLADES // 2):
            turn = optics.turn_rad + np.pi * blade / (_BLADES // 2)
            beside = np.degrees(dx * np.sin(turn) - dy * np.cos(turn)) / wide
            added = added + _STREAKS * np.exp(-(beside**2) / 2) / (1 + squared / far**2)
        for place, radius_deg, bright in zip(optics.place, optics.radius_deg, optics.bright, strict=True):
            apart = np.degrees(np.hypot(x - place * light[0], y[:, None] - place * light[1])) / radius_deg
            # A disc with a soft rim, a little brighter at its edge.
            added = added + _GHOST * bright * (0.6 + 0.4 * apart**2) / (
                1 + np.exp(np.minimum(12 * (apart - 1), 50))
            )
        return (added / (1 + (np.degrees(off) / _WELL_INSIDE_DEG) ** 2)).astype(np.float32)


def _turn(motion: Motion, before_s: float, after_s: float) -> np.ndarray:
    """(3, 3) rotation from the camera's frame at one time to that at another."""
    before, after = (motion.T_world_cam(at_s)[:3, :3] for at_s in (before_s, after_s))
    return after.T @ before
