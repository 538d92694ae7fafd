"""Images rectified to a pinhole camera: on request, and where a fisheye sees too far for one."""

from dataclasses import replace

import cv2
import numpy as np

from dslab.scenarios.errors import notice
from dslab.scenarios.lenses import MOST_HALF_ANGLE_DEG, sees_too_far
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.distortion import project
from dslab.sim.sequence import FrameSource, Sequence, colour_frame

_MOST_LONGER, _SEARCH_STEPS = 4.0, 20
_EDGE_PX = 1e-3  # rounding of a lens without effect there


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
    return _remapped(sequence, ideal)


def rectified(sequence: Sequence) -> Sequence:
    """The sequence itself without distortion, else as a pinhole camera of the same size and centre sees it.

    Its focal length is the lens's, or as much longer as it takes that every pixel shows something.
    """
    camera = sequence.camera
    if camera.is_pinhole:
        return sequence
    least, most = 1.0, _MOST_LONGER
    if _sees_all(camera, _longer(camera, least)):
        most = least
    for _ in range(_SEARCH_STEPS if most > least else 0):
        middle = (least + most) / 2
        least, most = (least, middle) if _sees_all(camera, _longer(camera, middle)) else (middle, most)
    return _remapped(sequence, _longer(camera, most))


def _longer(camera: Intrinsics, factor: float) -> Intrinsics:
    """A pinhole camera of a longer focal length."""
    pinhole = {"model": "radtan", "distortion": (0.0,) * 5}
    return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor, **pinhole)


def _sees_all(camera: Intrinsics, ideal: Intrinsics) -> bool:
    """Whether the pixels along the border of a pinhole image lie in the camera's image, so that all do."""
    x, y = np.arange(ideal.width_px), np.arange(ideal.height_px)
    sides = [np.column_stack([x, np.full(len(x), row)]) for row in (0, ideal.height_px - 1)]
    sides += [np.column_stack([np.full(len(y), column), y]) for column in (0, ideal.width_px - 1)]
    rays = (np.concatenate(sides) - ideal.centre_px) / ideal.focal_px
    at = project(camera, rays)
    return bool(((at >= -_EDGE_PX) & (at <= np.subtract(camera.size_px, 1) + _EDGE_PX)).all())


def _remapped(sequence: Sequence, ideal: Intrinsics) -> Sequence:
    frames = Remapped(sequence.frames, sequence.camera, ideal, cv2.INTER_LINEAR)
    depths = sequence.depths
    depths = None if depths is None else Remapped(depths, sequence.camera, ideal, cv2.INTER_NEAREST)
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
