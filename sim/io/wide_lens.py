"""Fisheye images that see further to the side than a pinhole image can hold, rectified as they are read."""

from dataclasses import replace

import cv2
import numpy as np

from dslab.scenarios.errors import notice
from dslab.scenarios.lenses import MOST_HALF_ANGLE_DEG, sees_too_far
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.distortion import project
from dslab.sim.sequence import FrameSource, Sequence, colour_frame


def rectified_if_wide(where: str, sequence: Sequence) -> Sequence:
    """The sequence itself, or as a pinhole camera of the same focal length and size sees it.

    The pinhole image shows the middle of the view at the resolution that it had; what it leaves out is said.
    """
    camera = sequence.camera
    if not sees_too_far(camera.size_px, camera.focal_px, camera.centre_px, camera.model, camera.distortion):
        return sequence
    ideal = replace(camera, model="radtan", distortion=(0.0,) * 5)
    across = [np.degrees(np.arctan(np.ptp(rays) / 2)) * 2 for rays in ideal.rays()]
    notice(
        where,
        f"the lens sees more than {MOST_HALF_ANGLE_DEG:g} degrees to the side: images are rectified to a "
        f"pinhole of the same focal length, {across[0]:.0f} x {across[1]:.0f} degrees",
    )
    frames = Remapped(sequence.frames, camera, ideal, cv2.INTER_LINEAR)
    depths = None if sequence.depths is None else Remapped(sequence.depths, camera, ideal, cv2.INTER_NEAREST)
    return replace(sequence, camera=ideal, frames=frames, depths=depths)


class Remapped:
    """A ``FrameSource`` of another camera at the same place.

    Args:
        source: images (H, W) of a camera.
        camera: that camera.
        ideal: the pinhole camera of the result.
        interpolation: OpenCV's.
    """

    def __init__(
        self, source: FrameSource, camera: Intrinsics, ideal: Intrinsics, interpolation: int
    ) -> None:
        self._source, self._interpolation = source, interpolation
        rays = np.stack(np.meshgrid(*ideal.rays()), axis=-1)
        at = project(camera, rays.reshape(-1, 2)).reshape(rays.shape)
        self._map = at.astype(np.float32)

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W) of the source's type; 0 where the source does not reach."""
        return cv2.remap(self._source[index], self._map, None, self._interpolation)

    def colour(self, index: int) -> np.ndarray:
        """See ``colour_frame``."""
        return cv2.remap(colour_frame(self._source, index), self._map, None, self._interpolation)
