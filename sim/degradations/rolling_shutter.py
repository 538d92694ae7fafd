"""Rolling shutter: rows are read one after the other while the camera moves."""

import cv2
import numpy as np
from numba import njit

from dslab.scenarios.segments import RollingShutter
from dslab.sim.degradations.base import Stage
from dslab.sim.degradations.image import Filter, ImageDegradation, Streams, View
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.exposure import row_shifts

FELT_PX = 2.0
# Poses are computed at this many times of the readout and interpolated linearly.
_POSES = 25


class RollingShutterDegradation(ImageDegradation[RollingShutter]):
    """Samples each row, at its own time, from the frame at the middle row's time.

    The shift follows from depth and motion. Parts that the frame did not see, beyond its borders or behind
    near surfaces, are filled from beside them. Behind a distorting lens, rows are those of the undistorted
    image.
    """

    kind = "rolling_shutter"
    stage = Stage.READOUT
    measure_name = "row_shift_px"
    needs_depth = True
    is_drawn = False
    needs_motion = True

    def prepare(self, segment: RollingShutter, camera: Intrinsics, streams: Streams) -> Filter:
        k = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
        row_share = np.arange(camera.height_px) / (camera.height_px - 1) - 0.5

        def read_out(image: np.ndarray, view: View) -> tuple[np.ndarray, float]:
            readout_s = view.strength * segment.readout_s
            if readout_s == 0:
                return image, 0.0
            if view.depth_m is None or view.motion is None:
                raise ValueError("a rolling shutter needs depth and motion")
            knots = np.linspace(-0.5, 0.5, _POSES)
            T_world_knot = view.motion.T_world_cam(view.stamp_s + readout_s * knots)
            T_mid_knot = np.linalg.inv(view.motion.T_world_cam(view.stamp_s)) @ T_world_knot
            T_mid_row = _between(knots, T_mid_knot[:, :3], row_share)
            map_x, map_y = row_maps(view.depth_m, k, T_mid_row.astype(np.float32))
            shift_px = np.hypot(map_x - np.arange(camera.width_px), map_y - np.arange(len(map_y))[:, None])
            out = cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            return out, float(shift_px[::8, ::8].max())

        return read_out

    def threshold(self, segment: RollingShutter) -> float:
        """A shift that bends the geometry beyond the noise of features."""
        return FELT_PX


def _between(knots: np.ndarray, poses: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(M, 3, 4) poses at (M,) positions among (K,) knots, near enough for linear mixing."""
    place = (at - knots[0]) / (knots[1] - knots[0])
    left = np.minimum(place.astype(int), len(knots) - 2)
    part = (place - left)[:, None, None]
    return np.ascontiguousarray((1 - part) * poses[left] + part * poses[left + 1])


@njit(cache=True, nogil=True, error_model="numpy")
def row_maps(depth_m, k, T_mid_row):
    """Position of each pixel's light in the frame of the middle row's time: two (H, W) float32, x and y.

    The depth that a row saw is known only at that position, so a second iteration takes it from there.

    Args:
        depth_m: (H, W) float32 depth of the middle row's frame.
        k: (4,) float32 fx, fy, cx, cy.
        T_mid_row: (H, 3, 4) float32 camera at each row's time to camera at the middle row's.
    """
    height, width = depth_m.shape
    map_x, map_y = np.empty_like(depth_m), np.empty_like(depth_m)
    depth_row = np.empty(width, np.float32)
    half = np.float32(0.5)
    right, bottom, zero = np.float32(width - 1), np.float32(height - 1), np.float32(0)
    for row in range(height):
        shift_x, shift_y = map_x[row], map_y[row]
        row_shifts(row, depth_m[row], k, T_mid_row[row], shift_x, shift_y)
        for column in range(width):
            x = min(max(np.float32(column) + shift_x[column], zero), right)
            y = min(max(np.float32(row) + shift_y[column], zero), bottom)
            depth_row[column] = depth_m[np.int32(y + half), np.int32(x + half)]
        row_shifts(row, depth_row, k, T_mid_row[row], shift_x, shift_y)
        for column in range(width):
            shift_x[column] += np.float32(column)
            shift_y[column] += np.float32(row)
    return map_x, map_y
